"""The sweep before lies where the current one sees it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.lattice.trig import TWO_PI, arctan2
from salpcc.stages.lattice.untwist import inverse, moved, twist
from salpcc.stages.predict.learned.previous_sweep import cones, warp
from salpcc.stages.predict.learned.recipe import Recipe
from salpcc.stages.predict.learned.train import collect
from salpcc.stages.predict.ring_rows import PAD
from salpcc.stages.residual_code.gop import decode_gop, encode_gop


def test_without_motion_a_sweep_sees_itself(make_scan: Callable[..., Scan], sensor: SensorModel) -> None:
    still = np.zeros(6)
    sweep = replace(scan_to_sweep(make_scan(motion=None), sensor), motion=still)
    seen = warp(sweep, still, sensor)
    assert seen.number.sum() > 0.99 * len(sweep.laser)
    for k in (5, 40):
        m = seen.number[k]
        ring = sweep.laser == k
        assert abs(m - ring.sum()) < 10
        azimuth = seen.azimuth[k, : m + 2 * PAD]
        assert (np.diff(azimuth) >= 0).all()
        range_ = np.median(sweep.count[ring]) * sensor.count
        assert abs(np.median(1 / seen.inverse[k, PAD : PAD + m]) - range_ * np.cos(sensor.theta[k])) < 0.05


def test_a_wall_comes_nearer(make_scan: Callable[..., Scan], sensor: SensorModel) -> None:
    """The sensor turns clockwise, so driving forward is a negative v."""
    forward = np.array([-1.0, 0, 0, 0, 0, 0])
    sweep = replace(scan_to_sweep(make_scan(motion=None), sensor), motion=np.zeros(6))
    before = warp(sweep, np.zeros(6), sensor)
    after = warp(replace(sweep, motion=forward), forward, sensor)
    ahead = [
        np.median(1 / seen.inverse[5, PAD : PAD + 30][seen.azimuth[5, PAD : PAD + 30] < 100])
        for seen in (before, after)
    ]
    assert ahead[1] == pytest.approx(ahead[0] - 1.0, abs=0.2)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e12, 1e300])
def test_any_motion_ends(make_scan: Callable[..., Scan], sensor: SensorModel, size: float) -> None:
    sweep = replace(scan_to_sweep(make_scan(motion=None), sensor), motion=np.full(6, size))
    seen = warp(sweep, np.array([1, -1, 1, 2 * np.pi, -1, 1]) * size, sensor)
    assert seen.number.sum() <= len(sweep.laser)


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0])
def test_blocks_give_what_one_return_after_the_other_gives(
    make_scan: Callable[..., Scan], sensor: SensorModel, size: float
) -> None:
    """Also where Newton steps do not end at once, where points come near the axis, and where the nearest cone is far off."""
    motion = np.array([-0.8, 0.1, -0.3, 2e-3, -1e-3, -0.03]) * size
    sweep = replace(scan_to_sweep(make_scan(motion=None), sensor), motion=motion)
    points = twist(unproject(sensor, sweep.laser, sweep.tick, sweep.count.astype(np.float64)), motion)
    cone = cones(sensor)[:, 1].astype(np.float64)
    expected = []
    for number, (point, laser) in enumerate(zip(points, sweep.laser.tolist(), strict=True)):
        x, y, z = moved(*moved(*point, 0.5, motion), 0.5, motion)
        if not 0.25 < x * x + y * y < 1e8:
            continue
        x, y, z = inverse(x, y, z, motion, 0)
        rho = np.sqrt(x * x + y * y)
        if not 0.5 < rho < 1e4:
            continue
        off = abs(z - sensor.parameters[:, 1] - rho * cone)
        k = laser
        for way in (-1, 1):
            while 0 <= k + way < len(off) and off[k + way] < off[k]:
                k += way
        turn = np.float32(arctan2(y, x) * (4000 / TWO_PI) % 4000)
        expected.append((k, turn, number, np.float32(1 / rho), np.float32(z / rho)))
    expected.sort()
    seen = warp(sweep, motion, sensor)
    within = [slice(PAD, PAD + m) for m in seen.number]
    for column, rows in ((1, seen.azimuth), (3, seen.inverse), (4, seen.height)):
        found = np.concatenate([row[part] for row, part in zip(rows, within, strict=True)])
        np.testing.assert_array_equal(found, np.array([e[column] for e in expected], np.float32))
    np.testing.assert_array_equal(
        seen.number, np.bincount([e[0] for e in expected], minlength=sensor.n_lasers)
    )


def test_it_saves_bytes(make_scan: Callable[..., Scan], sensor: SensorModel) -> None:
    """The same scan twice: the second takes fewer bytes where the first is looked at."""
    still = np.array([1e-9, 0, 0, 0, 0, 0])
    sweep = replace(scan_to_sweep(make_scan(motion=None), sensor), motion=still)
    first, second = encode_gop([sweep, sweep], sensor, "max")
    assert len(second.data) < len(first.data)
    decoded = list(decode_gop([first.data, second.data], sensor))
    np.testing.assert_array_equal(decoded[1].count, sweep.count)


def test_rows_to_train_on(make_scan: Callable[..., Scan], sensor: SensorModel) -> None:
    sweep = scan_to_sweep(make_scan(), sensor)
    ranges, values = collect([(sweep, None), (sweep, sweep)], sensor, Recipe(looks_back=True))
    assert ranges["x"].shape[1] == 104
    assert ranges["mu"].shape[1] == 13
    assert values["x"].shape[1] == 80
    assert set(values["side"][: len(values["side"]) // 3, 2]) == {101}
