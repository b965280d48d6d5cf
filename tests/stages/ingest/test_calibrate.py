"""A sensor model is found from nothing but scans: lasers, steps, levers, whatever the order of the list."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.errors import SensorError
from salpcc.stages.ingest.calibrate.fit_sensor import fit_sensor, share_exact
from salpcc.stages.ingest.simulator.config import SimulationConfig
from salpcc.stages.ingest.simulator.scans import simulate_scans
from salpcc.stages.lattice.find_lasers import Listed
from salpcc.stages.lattice.lattice import driven, unproject
from salpcc.stages.lattice.list_motion import places, redo, solve
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor

TURNING = np.array([-0.6, 0.01, 0.005, 1e-3, -5e-4, 4e-3])


@pytest.fixture(scope="module")
def small_sensor(sensor):
    pick = [0, 20, 40, 60]
    arrays = {k: getattr(sensor, k)[pick] for k in ("theta", "z0", "h", "phi0", "d0", "shift")}
    return replace(sensor, name="small", **arrays)


@pytest.fixture(scope="module")
def raw_scans(small_sensor):
    rng = np.random.default_rng(0)
    scans = []
    for _ in range(6):
        firings = np.cumsum(rng.choice([1, 2], 2600, p=[0.15, 0.85]))
        firings = firings[firings < small_sensor.ticks_per_turn]
        laser = np.repeat(np.arange(4), len(firings))
        tick = (np.tile(firings, 4) + small_sensor.shift[laser]) % small_sensor.ticks_per_turn
        count = rng.integers(1500, 30_000, len(laser))
        model = unproject(small_sensor, laser.astype(np.uint8), tick.astype(np.int32), count.astype(np.int32))
        order = np.lexsort((azimuth_keys(model), laser))
        scans.append(Listed(np.rint(model[order] * 1000) / 1000.0))
    return scans


def fan(lasers: int, low: float, high: float) -> SensorModel:
    """A sensor without levers whose lasers lie ``low`` to ``high`` degrees up, on KITTI's steps."""
    none = np.zeros(lasers)
    elevation = np.radians(np.linspace(high, low, lasers))
    return SensorModel(
        f"fan{lasers}", 4000, 0.002, elevation, none, none, none, none, np.zeros(lasers, np.int64)
    )


def spinning(
    ticks: int, count: float, lasers: int = 16, firings: int = 720
) -> tuple[SensorModel, Listed, np.ndarray]:
    """A sensor with levers, and one turn of it in the order of its firings, not rounded; with the laser of each point."""
    rng = np.random.default_rng(lasers)
    model = SensorModel(
        "levers", ticks, count, np.radians(np.linspace(-15, 15, lasers)), rng.normal(0, 0.01, lasers), rng.normal(0, 0.004, lasers),
        rng.uniform(-0.4, 0.4, lasers) * 2 * np.pi / ticks, rng.uniform(-0.4, 0.4, lasers) * count, np.zeros(lasers, np.int64),
    )  # fmt: skip
    laser = np.tile(np.arange(lasers), firings)
    tick = np.repeat(np.rint(np.arange(firings) * ticks / firings), lasers).astype(np.int64)
    far = 8.0 + 4.0 * np.sin(6 * np.pi * tick / ticks) + 3.0 * (tick * 40 // ticks % 2)
    distance = np.minimum(far, 1.7 / np.maximum(-np.sin(model.theta[laser]), 0.02)) + rng.normal(
        0, 0.01, len(laser)
    )
    points = unproject(model, laser.astype(np.uint8), tick.astype(np.int32), np.rint(distance / count))
    return model, Listed(points), laser


def test_finds_the_sensor(small_sensor, raw_scans) -> None:
    found = fit_sensor(raw_scans, "found", rounded=True)
    assert (found.model.ticks_per_turn, found.model.count) == (4000, 0.002)
    assert share_exact(found, small_sensor) == 1.0
    assert share_exact(found) > 0.99
    assert np.abs(found.model.theta - small_sensor.theta).max() < 1e-6
    assert np.abs(found.model.h - small_sensor.h).max() < 1e-5
    relative = (found.model.shift - small_sensor.shift) % small_sensor.ticks_per_turn
    assert len(set(relative.tolist())) == 1


@pytest.mark.parametrize(("lasers", "low", "high"), [(16, -15, 15), (32, -30.67, 10.67), (128, -25, 15)])
def test_finds_simulated_sensors(lasers: int, low: float, high: float) -> None:
    truth = fan(lasers, low, high)
    config = SimulationConfig(scans=1, shadow=False)
    (scan,) = simulate_scans(config, truth)
    raw = scan.raw.astype(np.float64)
    if lasers == 32:  # as they were fired, with gaps: no distance in the list tells the laser
        raw = raw[np.lexsort((scan.laser, scan.tick))]
    found = fit_sensor([Listed(raw)], "found", rounded=True)
    model = found.model
    assert (model.n_lasers + found.missing, model.ticks_per_turn, model.count) == (lasers, 4000, 0.002)
    nearest = np.abs(model.theta[:, None] - truth.theta[None]).argmin(axis=1)
    assert np.degrees(np.abs(model.theta - truth.theta[nearest])).max() < 0.005
    assert len(set(nearest.tolist())) == model.n_lasers
    assert share_exact(found) > 0.97


@pytest.mark.parametrize(
    ("ticks", "count", "order"),
    [
        (36_000, 0.002, "firings"),
        (36_000, 0.002, "numbered"),
        (1024, 0.001, "organised"),
        (1024, 0.001, "rings"),
        (2048, 0.008, "firings"),
    ],
)
def test_finds_steps_in_any_order(ticks: int, count: float, order: str) -> None:
    truth, scan, laser = spinning(ticks, count)
    by_ring = np.argsort(laser, kind="stable")
    listed = {
        "firings": scan,
        "rings": Listed(scan.points[by_ring]),
        "organised": Listed(scan.points[by_ring], width=720),
        "numbered": Listed(scan.points[by_ring[::-1]], ring=laser[by_ring[::-1]] + 3),
    }[order]
    found = fit_sensor([listed], "found", rounded=False)
    assert (found.model.n_lasers, found.model.count, found.moved) == (16, count, 0)
    # A ring of 720 firings every so many ticks is a lattice of its own.
    assert found.model.ticks_per_turn % 720 == 0 or found.model.ticks_per_turn == ticks
    assert np.degrees(np.abs(np.sort(found.model.theta) - truth.theta)).max() < 1e-4
    assert found.share_within(1e-4) > 0.999


def test_finds_lasers_of_a_narrow_room_by_their_sines() -> None:
    """Without rings and levers, and with firings that lack returns: no list repeats, and near points have any slope but that of their laser."""
    truth = load_sensor("qt64")
    rng = np.random.default_rng(5)
    firings = 300
    laser = np.tile(np.arange(truth.n_lasers), firings)
    tick = (np.repeat(np.arange(firings) * 120, truth.n_lasers) + truth.shift[laser]) % truth.ticks_per_turn
    count = np.rint(rng.uniform(0.3, 1.5, len(laser)) / truth.count)
    points = driven(truth, laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    points = points[rng.random(len(points)) < 0.6].astype(np.float64)
    found = fit_sensor([Listed(points)], "found", rounded=False)
    assert (found.model.n_lasers, found.missing) == (truth.n_lasers, 0)
    assert found.model.bit_identical_share > 0.99


def test_undoes_the_motion_of_firings() -> None:
    _, scan, laser = spinning(36_000, 0.002, lasers=32, firings=1084)
    s = places(len(laser), 32)
    moved = redo(scan.points, s, TURNING)
    found = solve(moved, laser, s, 32)
    assert found is not None
    assert (found.ticks, found.count) == (36_000, 0.002)
    assert np.abs(found.motion - TURNING)[:3].max() < 1e-3
    fit = fit_sensor([Listed(moved)], "found", rounded=False)
    assert fit.moved == 1
    assert fit.share_within(0.002) > 0.95


def test_too_little_to_calibrate_on(raw_scans) -> None:
    with pytest.raises(SensorError, match="no scan"):
        fit_sensor([], "x", rounded=True)
    with pytest.raises(SensorError, match="more scans"):
        fit_sensor([Listed(raw_scans[0].points[::20])], "x", rounded=True)


def test_what_is_no_spinning_sensor() -> None:
    blob = np.random.default_rng(0).normal(0, 20, (20_000, 3))
    with pytest.raises(SensorError, match="no spinning LiDAR"):
        fit_sensor([Listed(blob)], "x", rounded=False)


def test_scans_of_two_sensors() -> None:
    (_, one, _), (_, other, _) = spinning(1024, 0.001, 16), spinning(1024, 0.001, 20)
    tilted = other.points @ np.array([[1, 0, 0], [0, 1, 0], [0, 0.0, 0.6]])
    with pytest.raises(SensorError, match="different sensors"):
        fit_sensor([one, one, Listed(tilted)], "x", rounded=False)


def test_real_sweep_of_nuscenes(real_data) -> None:
    file = real_data / "other_sensors" / "nuscenes_lidar_top.pcd.bin"
    if not file.is_file():
        pytest.skip(f"{file} is absent")
    rows = np.fromfile(file, "<f4").reshape(-1, 5).astype(np.float64)
    fit = fit_sensor([Listed(rows[:, :3])], "hdl32e", rounded=False)
    assert (fit.model.n_lasers, fit.model.ticks_per_turn, fit.model.count, fit.moved) == (
        32,
        36_000,
        0.002,
        1,
    )
    data_sheet = np.linspace(-30.67, 10.67, 32)
    assert np.abs(np.degrees(fit.model.theta) - data_sheet).max() < 0.05
    assert fit.share_within(0.005) > 0.98


@pytest.mark.parametrize("kind", ["near", "thinned", "part"])
def test_a_shipped_model_is_recognised_in_what_is_left_of_a_cloud(kind: str) -> None:
    """No ring numbers, and nothing beyond 4 m, or every third point, or half a turn: too little to find all lasers by."""
    sensor = load_sensor("vlp32c")
    rng = np.random.default_rng(0)
    laser, firing = np.tile(np.arange(sensor.n_lasers), 600), np.repeat(np.arange(600), sensor.n_lasers)
    far = (2.5 if kind == "near" else 9.0) + np.sin(firing / 60) + rng.normal(0, 0.01, len(laser))
    seen = rng.random(len(laser)) < np.where(laser % 5 == 0, 0.05, 0.8)
    seen &= {"near": True, "thinned": np.arange(len(laser)) % 3 == 0, "part": firing < 300}[kind]
    points = driven(
        sensor, laser.astype(np.uint8), (firing * 60).astype(np.int32), np.rint(far / sensor.count)
    ).astype(np.float32)[seen]
    fit = fit_sensor([Listed(points.astype(np.float64))], "x", rounded=False)
    assert fit.model.n_lasers == sensor.n_lasers
    assert fit.model.driver is not None
    assert fit.model.bit_identical_share > 0.999
    assert fit.model.name == "x"
