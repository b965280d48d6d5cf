"""Drivers: formulas against plain NumPy, found near a fitted model, and points that need no corrections."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from salpcc.pipeline.sensors.calibration import calibrate_log
from salpcc.schemas.errors import SensorError
from salpcc.stages.ingest.calibrate.find_driver import share_identical
from salpcc.stages.ingest.calibrate.fit_sensor import fit_sensor
from salpcc.stages.lattice.drivers import FORMULAS, SINES, TURNING, Driver
from salpcc.stages.lattice.drivers.degrees import row_of
from salpcc.stages.lattice.drivers.sines import cosine32, sine32
from salpcc.stages.lattice.find_lasers import Listed
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel
from salpcc.stages.lists.list_coder import decode_list, encode_list
from salpcc.stages.lists.list_plan import plan

LASERS, FIRINGS = 5, 900
F = np.float32


@njit
def _sines(kind, angles):
    both = np.empty((len(angles), 2), np.float32)
    for i, a in enumerate(angles):
        both[i, 0], both[i, 1] = sine32(kind, a), cosine32(kind, a)
    return both


@pytest.mark.parametrize("kind", range(len(SINES)))
def test_sines_are_within_a_bit(kind: int) -> None:
    angles = np.random.default_rng(0).uniform(-7, 7, 20_000).astype(F)
    got = _sines(kind, angles)
    wanted = np.array([(math.sin(a), math.cos(a)) for a in angles.astype(float)]).astype(F)
    off = np.abs(got.view(np.int32) - wanted.view(np.int32))
    assert off.max() == kind
    assert (off > 0).mean() <= 0.03 * kind


def turn(formula: str, single: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """Points ``(N, 3)`` of a room, by the formula in NumPy, their lasers, and metres per count."""
    rng = np.random.default_rng(LASERS)
    unit = 0.004
    elevation, offset = np.radians(np.linspace(-14, 12, LASERS)), np.radians(np.linspace(-3.1, 2.7, LASERS))
    laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    index = (firing * 40 + rng.integers(0, 3, FIRINGS)[firing]) % 36_000
    wall = 9.0 + 4.0 * np.sin(firing / FIRINGS * 6 * np.pi) + 3.0 * (firing // 90 % 2)
    count = np.rint((wall + rng.normal(0, 0.02, len(laser))) / unit)
    d = count.astype(F) * F(unit) if single else (count * unit).astype(F)
    offset *= formula != "nebula"  # whose indices have it
    e, o = elevation.astype(F)[laser], offset.astype(F)[laser]
    rho = d * np.cos(e.astype(float)).astype(F)
    z = d * np.sin(e.astype(float)).astype(F)
    if formula == "hesai":
        a = ((index * 0.01 * np.pi / 180).astype(F) + o).astype(float)
        return np.stack([rho * np.sin(a).astype(F), rho * np.cos(a).astype(F), z], axis=1), laser, unit
    if formula.startswith("pandar"):
        a = (index.astype(F) * F(2 * np.pi / 36_000)).astype(float)
        if formula == "pandar_degrees":
            a = ((index.astype(F) * F(0.01)).astype(float) * np.pi / 180).astype(F).astype(float)
        c, s, co, so = (f(v).astype(F) for v in (a, o.astype(float)) for f in (np.cos, np.sin))
        return np.stack([-rho * (c * co - s * so), rho * (s * co + c * so), z], axis=1), laser, unit
    a = (index.astype(F) * F(0.01)).astype(float) if formula == "velodyne" else index * 0.01
    a = (a * np.pi / 180).astype(F).astype(float)
    c, s, cr, sr = (f(v).astype(F) for v in (a, o.astype(float)) for f in (np.cos, np.sin))
    return np.stack([rho * (c * cr + s * sr), -(rho * (s * cr - c * sr)), z], axis=1), laser, unit


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("formula", sorted(TURNING))
def test_calibration_finds_the_driver(formula: str, single: bool) -> None:
    points, laser, unit = turn(formula, single)
    fit = fit_sensor([Listed(points.astype(np.float64), laser)], "x", rounded=False)
    driver = fit.model.driver
    assert driver is not None
    assert (driver.formula, driver.sine, driver.single) == (formula, "rounded", single)
    assert fit.model.bit_identical_share > 0.995
    assert fit.model.count == unit
    again = SensorModel.from_json(fit.model.to_json())
    assert again.to_json() == fit.model.to_json()
    assert share_identical(again, points) == pytest.approx(fit.model.bit_identical_share, abs=1e-6)
    plain = replace(fit.model, driver=None)
    sizes = [len(encode_list(np.arange(len(points)), plan(points, 0.0, m))) for m in (again, plain)]
    assert sizes[0] < 0.65 * sizes[1]
    for bound in (0.0, 0.01):
        data = encode_list(np.arange(len(points)), plan(points, bound, again, settled=bound == 0.0))
        _, back, _, sound = decode_list(len(points), bound, np.frombuffer(bytearray(data), np.uint8), again)
        assert sound
        assert np.linalg.norm(back.astype(np.float64) - points, axis=1).max() <= bound


def test_calibration_finds_a_driver_that_computes_in_float64() -> None:
    points, laser, unit = turn("hesai", False)
    rng = np.random.default_rng(1)
    elevation, offset = (
        np.radians(np.round(np.linspace(*ends, LASERS), 3))[laser] for ends in ((-14, 12), (-3.1, 2.7))
    )
    azimuth = np.radians(rng.integers(0, 600, len(laser)) * 0.6) + offset
    d = np.rint(np.linalg.norm(points.astype(np.float64), axis=1) / unit) * unit
    rho = d * np.cos(elevation)
    points = np.stack([rho * np.sin(azimuth), rho * np.cos(azimuth), d * np.sin(elevation)], axis=1).astype(F)
    model = fit_sensor([Listed(points.astype(np.float64), laser)], "x", rounded=False).model
    assert model.driver is not None
    assert model.driver.steps == model.ticks_per_turn == 600
    assert model.bit_identical_share > 0.98


def columns(
    rows: int, width: int, n: float = 15.806e-3, t: float = 36.18e-3, void: float = 0.2
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An organised cloud by the formula of Ouster's SDK in NumPy, beams from ``n`` metres beside the axis and ``t`` up: points, rows, and the elevations in degrees."""
    rng = np.random.default_rng(0)
    row, column = np.repeat(np.arange(rows), width), np.tile(np.arange(width), rows)
    up = np.round(np.linspace(20, -21, rows), 2)
    aside = np.array([4.23, 1.41, -1.4, -4.22])[np.arange(rows) % 4]
    turned = 2 * np.pi * (1 - column / width)
    elevation, azimuth = np.radians(up)[row], -np.radians(aside)[row]
    wall = 6.0 + 2.0 * np.sin(3 * turned) + rng.normal(0, 0.03, len(row))
    r = np.rint(np.minimum(wall, 1.6 / np.maximum(-np.sin(elevation), 0.02)) * 1000) / 1000 - n
    rho = r * np.cos(elevation)
    xyz = np.stack(
        [
            -(rho * np.cos(turned + azimuth) + n * np.cos(turned)),
            -(rho * np.sin(turned + azimuth) + n * np.sin(turned)),
            r * np.sin(elevation) + t,
        ],
        axis=1,
    )
    xyz[rng.random(len(row)) < void] = 0
    return xyz.astype(F), row, up


@pytest.mark.parametrize(
    ("n", "t", "void"), [(15.806e-3, 36.18e-3, 0.2), (27.116e-3, 38.195e-3, 0.2), (21.042e-3, 40.1e-3, 0.85)]
)
def test_calibration_finds_beams_beside_the_axis(n: float, t: float, void: float) -> None:
    """Whatever the distance, which no data sheet need have, and where few returns show the steps of azimuths or a multiple of them."""
    points, row, up = columns(32, 1024, n, t, void)
    model = fit_sensor([Listed(points.astype(np.float64), row, 1024)], "x", rounded=False).model
    assert model.driver is not None
    assert (model.driver.formula, model.driver.steps) == ("ouster", 1024)
    assert (model.driver.lasers[:, 0] == np.rint(up * 1000)).all()
    assert model.bit_identical_share > 0.98
    again = SensorModel.from_json(model.to_json())
    assert again.to_json() == model.to_json()
    data = encode_list(np.arange(len(points)), plan(points, 0.0, again))
    _, back, _, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8), again)
    assert sound
    assert back.tobytes() == points.tobytes()


RECORDINGS = {
    "vlp32c_tier4": 0.999,
    "hesai_xt32m": 0.999,
    "ouster_os1_32": 0.999,
    "av2_7fab": None,
    "hesai_ot128": 0.999,
}


@pytest.mark.parametrize("name", sorted(RECORDINGS))
def test_recordings(name: str, real_data: Path) -> None:
    """What is known comes back bit for bit; two sensors in one cloud, and what is modelled wrongly, are not claimed."""
    log = real_data / "sensors" / f"{name}.mcap"
    if not log.is_file():
        pytest.skip(f"{log} is not there")
    least = RECORDINGS[name]
    if least is None:
        with pytest.raises(SensorError, match="of all returns"):
            calibrate_log(log, 2, name)
    else:
        assert calibrate_log(log, 2, name).fit.model.bit_identical_share > least


_SCRIPT = """
import sys, zlib, numpy as np
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import SensorModel
at = np.arange(0, 36000, 7, dtype=np.int32)
for text in sys.argv[1:]:
    points = driven(SensorModel.from_json(text), (at % 3).astype(np.uint8), at, at * 1.5)
    print(zlib.crc32(points.tobytes()))
"""


def test_a_plain_processor_gives_the_same() -> None:
    """Kernels compiled for no particular processor (no FMA) make the same bits, whatever the formula and the sine."""
    zero = np.zeros(3)
    sensors = []
    for formula, sine in product(sorted(TURNING), SINES):
        numbers = [FORMULAS[formula].row(SINES.index(sine), F(o)) for o in (-0.02, 0.0, 0.013)]
        driver = Driver(formula, sine, True, np.array([(0.9, 0.43588990, *row) for row in numbers], F))
        of_lasers = (zero, zero, zero, zero, zero, zero.astype(np.int64))
        sensors.append(SensorModel("x", 36_000, 0.002, *of_lasers, driver).to_json())
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}  # numba keeps kernels by these
    command = [sys.executable, "-c", _SCRIPT, *sensors]
    here, there = (
        subprocess.run(command, env=os.environ | env, capture_output=True, text=True, check=True).stdout
        for env in ({}, plain)
    )
    assert here == there and len(here.splitlines()) == len(sensors)


def test_models_without_a_driver_are_as_they_were() -> None:
    text = (SENSORS / "hdl64e.json").read_text()
    model = SensorModel.from_json(text)
    assert model.driver is None
    assert model.to_json() == text
    at = np.zeros(1, np.int32)
    assert (driven(model, at.astype(np.uint8), at, at + 100.0) != 0).any()


@pytest.mark.parametrize(
    "change",
    [
        {"formula": "nobody's"},
        {"sine": "x"},
        {"lasers": [[1, 0, 0]]},
        {"lasers": []},
        {"lasers": [[1e99, 0, 0, 0]]},
    ],
)
def test_damaged_drivers_are_refused(change: dict) -> None:
    model = SensorModel.from_json((SENSORS / "hdl64e.json").read_text())
    lasers = np.tile(np.array([1, 0, 1, 0], F), (model.n_lasers, 1))
    sound = replace(model, ticks_per_turn=36_000, driver=Driver("velodyne", "rounded", True, lasers))
    document = json.loads(sound.to_json())
    document["driver"] |= change
    with pytest.raises(SensorError):
        SensorModel.from_json(json.dumps(document))


def test_two_sensors_in_one_cloud_are_refused() -> None:
    """Most points of a cloud of two sensors lie on no laser of what is found; nothing is claimed then."""
    one, laser, _ = turn("velodyne", True)
    other = one[::-1] @ np.array([[0.96, 0.28, 0], [-0.28, 0.96, 0], [0, 0, 1]]) + (1.1, 0.2, 0.55)
    both = np.concatenate([one, other.astype(F)]).astype(np.float64)
    with pytest.raises(SensorError):
        fit_sensor([Listed(both, np.concatenate([laser, laser[::-1]]))], "x", rounded=False)


def test_a_small_room_and_voids_are_no_reason_to_refuse() -> None:
    points, laser, _ = turn("hesai", False)
    order = np.argsort(laser, kind="stable")
    rows = (points[order] / F(4.0)).astype(np.float64)  # nothing beyond 4 m
    rows[np.random.default_rng(0).random(len(rows)) < 0.7] = 0.0
    found = fit_sensor([Listed(rows, laser[order], FIRINGS)], "x", rounded=False)
    assert found.model.n_lasers == LASERS
    assert found.share_within(0.001) > 0.99


@pytest.mark.parametrize(("formula", "sine"), product(TURNING, SINES))
def test_round_angles_are_told_as_such_and_other_numbers_as_they_are(formula: str, sine: str) -> None:
    angles = [(-25, 0.911), (-15.639, 0), (0, -4.2), (2.333, 3)]
    kind = SINES.index(sine)
    rows = [row_of(FORMULAS[formula], kind, *told) for told in angles]
    odd = (rows[0][0], F(0.123), F(0.5), F(-0.0))  # of no angle
    driver = Driver(formula, sine, True, np.array([*rows, odd], F))
    told = driver.to_document()["lasers"]
    assert [tuple(laser) for laser in told[:-1]] == angles and len(told[-1]) == 4
    again = Driver.from_document(json.loads(json.dumps(driver.to_document())))
    assert again.lasers.tobytes() == driver.lasers.tobytes()


def test_beams_that_start_alike_are_told_once() -> None:
    lasers = np.array(
        [[100, 4, 15806, 36180], [90, -4, 15806, 36180], [80, 4, 15806, 0], [70, 4, 15806, 0]], F
    )
    driver = Driver("ouster", "rounded", False, lasers, 1024)
    told = driver.to_document()["lasers"]
    assert [len(laser) for laser in told] == [4, 2, 4, 2]
    assert Driver.from_document(driver.to_document()).lasers.tobytes() == lasers.tobytes()
    with pytest.raises(ValueError):
        Driver.from_document(driver.to_document() | {"lasers": told[1:]})
