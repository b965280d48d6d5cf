"""Made-up scenes: crops, mirrors, pasted instances that stand on ground and hide what is behind."""

import numpy as np
import pytest

from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import COLUMNS, RANGE, Z
from salpcc.stages.segment.training.crops import Crop, cut, distort, mirror
from salpcc.stages.segment.training.labelled import LabelledImage
from salpcc.stages.segment.training.scan_mixing import instances_of, mix, paste

ROAD, BUILDING, CAR = 9, 13, 1


@pytest.fixture(scope="module")
def street() -> LabelledImage:
    """A floor with walls around and one car ahead of the vehicle."""
    azimuth = (np.arange(COLUMNS) + 0.5) / COLUMNS
    azimuth = np.pi * (1 - 2 * azimuth)
    tangent = np.tan(np.deg2rad(np.linspace(1.5, -24.5, 64)))[:, None]
    ground = np.where(tangent < 0, 1.7 / np.maximum(-tangent, 1e-3), np.inf)
    rho = np.minimum(ground, 25.0) * np.ones(COLUMNS)
    classes = np.where(ground < 25.0, ROAD, BUILDING) * np.ones(COLUMNS, int)
    car = (np.abs(azimuth) < 0.1) & (10.0 * tangent < -0.3) & (10.0 * tangent > -1.65)
    rho[car], classes[car] = 10.0, CAR
    points = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), rho * tangent], -1).reshape(-1, 3)
    image = project(points.astype(np.float32), np.full(points.shape[0], 0.3, np.float32))
    found = np.where(image.index >= 0, classes.ravel()[image.index], 0).astype(np.uint8)
    return LabelledImage(image.planes, found, np.where(found == CAR, (5 << 16) + 10, 0).astype(np.uint32))


def test_instances_are_found_whole(street: LabelledImage) -> None:
    (car,) = instances_of(street)
    assert car.label == CAR and car.mask.sum() == (street.classes == CAR).sum()
    rolled = LabelledImage(
        *(np.roll(a, COLUMNS // 2, -1) for a in (street.planes, street.classes, street.instances))
    )
    (split,) = instances_of(rolled)  # across the seam
    assert (split.mask == car.mask).all() and split.first == (car.first + COLUMNS // 2) % COLUMNS


@pytest.mark.parametrize("flip", [False, True])
def test_a_pasted_car_stands_where_it_is_put(street: LabelledImage, flip: bool) -> None:
    (car,) = instances_of(street)
    crop = cut(street, 0, 512)
    crop = Crop(crop.planes.copy(), crop.classes.copy(), crop.first)
    before = crop.planes.copy()
    assert paste(crop, car, 200, COLUMNS, flip)
    new = crop.classes == CAR
    assert new.sum() == car.mask.sum() and new[:, 200 : 200 + car.mask.shape[1]].sum() == new.sum()
    assert (crop.planes[RANGE][new] < np.where(before[RANGE] > 0, before[RANGE], np.inf)[new]).all()
    # Its points lie in the very pixels that they were pasted into.
    again = project(np.ascontiguousarray(crop.planes[:3, new].T), np.zeros(new.sum(), np.float32))
    rows, columns = np.nonzero(new)
    assert np.abs(again.column - columns).max() <= 1
    assert np.abs(again.row - rows).max() <= 2  # it was lifted to the ground that it stands on


def test_a_car_needs_ground(street: LabelledImage) -> None:
    (car,) = instances_of(street)
    crop = cut(street, 0, 512)
    walls = Crop(crop.planes.copy(), np.full_like(crop.classes, BUILDING), 0)
    assert not paste(walls, car, 200, COLUMNS, False)
    assert not paste(walls, car, 511, COLUMNS, False)


def test_mirroring_twice_is_nothing(street: LabelledImage) -> None:
    crop = cut(street, 1900, 256)
    back = mirror(mirror(crop, COLUMNS), COLUMNS)
    assert (
        back.first == crop.first
        and (back.planes == crop.planes).all()
        and (back.classes == crop.classes).all()
    )
    once = mirror(crop, COLUMNS)
    seen = once.planes[RANGE] > 0
    again = project(np.ascontiguousarray(once.planes[:3, seen].T), np.zeros(seen.sum(), np.float32))
    wanted = (np.nonzero(seen)[1] + once.first) % COLUMNS
    assert (np.abs(again.column - wanted) % (COLUMNS - 1) <= 1).all()


def test_mixed_crops_hold_both(street: LabelledImage) -> None:
    rng = np.random.default_rng(0)
    crop, other = cut(street, 0, 256), cut(street, 900, 256)
    other.planes[Z] = -9.0
    taken = [(mix(crop, other, COLUMNS, rng).planes[Z] == -9.0).mean() for _ in range(10)]
    assert 0 < np.mean(taken) < 1


def test_distortion_keeps_labels_on_returns(street: LabelledImage) -> None:
    crop = cut(street, 700, 256)
    out = distort(crop, np.random.default_rng(3))
    gone = out.planes[RANGE] == 0
    assert not out.planes[:, gone].any() and not out.classes[gone].any()
    assert (out.classes[~gone] == crop.classes[~gone]).all()
    measured = np.linalg.norm(out.planes[:3, ~gone], axis=0)
    assert np.abs(measured / out.planes[RANGE, ~gone] - 1).max() < 0.03
