"""Pixel features: normals of known planes, steps between neighbours, turns that turn nothing but x and y."""

import numpy as np

from salpcc.stages.segment.network.features import CHANNELS, pixel_features
from salpcc.stages.segment.network.projection import project


def _ring(height: float) -> np.ndarray:
    """A floor ``height`` below the sensor as 40 rings see it."""
    azimuth = np.linspace(-np.pi, np.pi, 2048, endpoint=False) + 1e-3
    elevation = np.deg2rad(np.linspace(-6, -24, 43))
    rho = height / np.tan(-elevation)
    x = rho[:, None] * np.cos(azimuth)
    return np.stack([x, rho[:, None] * np.sin(azimuth), np.full_like(x, -height)], -1).reshape(-1, 3)


def test_a_floor_looks_up() -> None:
    points = _ring(1.7).astype(np.float32)
    image = project(points, np.full(len(points), 0.25, np.float32))
    features = pixel_features(image.planes, True)
    seen = (image.index >= 0) & (features[15] > 0)
    assert features.shape == (CHANNELS, 64, 2048) and seen.sum() > 20000
    assert features[14][seen].min() > 0.98
    assert np.abs(features[12][seen]).max() < 0.15
    assert np.allclose(features[17][image.index >= 0], 0.5)
    assert not features[:, image.index < 0].any()


def test_a_step_in_range_is_seen_from_both_sides() -> None:
    planes = np.zeros((6, 64, 32), np.float32)
    planes[0] = planes[3] = 10.0
    planes[[0, 3], :, 16:] = 14.0
    features = pixel_features(planes, False)
    assert (features[3, :, 15] > 0.9).all() and (features[2, :, 16] < -0.9).all()
    assert not features[2:6, :, :15].any()


def test_means_of_intensities_end_at_the_image() -> None:
    """The first and the last row have neighbours on one side; none is counted twice."""
    planes = np.zeros((6, 3, 8), np.float32)
    planes[3] = 10.0
    planes[4] = np.array([0.2, 0.4, 0.9])[:, None]
    mean = pixel_features(planes, True)[18] / 2
    assert np.allclose(mean, np.array([0.3, 0.5, 0.65])[:, None])


def test_turning_the_scan_turns_the_features(make_scan) -> None:
    planes = project(make_scan().points, make_scan().intensity).planes
    turned = np.roll(planes, 100, axis=2)
    wanted = np.roll(pixel_features(planes, True), 100, axis=2)
    assert (pixel_features(turned, True) == wanted).all()
    cropped = pixel_features(np.ascontiguousarray(planes[:, :, 200:400]), False)
    assert (cropped[:, :, 5:-5] == pixel_features(planes, True)[:, :, 205:395]).all()
