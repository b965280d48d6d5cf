"""A shipped model is found on the first clouds of a log; what it is not of is left to the default."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline.sensors import choose_sensor as module
from salpcc.pipeline.sensors.choose_sensor import OTHERWISE, OWN, choose_sensor, choose_unit
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.lattice.aim import share_on
from salpcc.stages.lattice.drivers import FORMULAS, SINES
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel, load_sensor, with_driver

SHIPPED = sorted(path.stem for path in SENSORS.glob("*.json"))


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """What is chosen for a log of one topic of such points."""

    def choose(points: np.ndarray, asked: SensorModel | None = None) -> tuple[str, float | None]:
        class Log:
            def scans(self, log, sequence, topics):
                return [ScanRef(f"{i:06d}", i, i, str(log), topic="/points") for i in range(2)]

            def read(self, ref, with_labels):
                return Scan(ref.name, points, np.zeros(len(points), np.float32))

        monkeypatch.setattr(module, "Bag", Log)
        if asked is not None:
            return choose_unit(Path("drive.mcap"), "drive", (), asked)
        return choose_sensor(Path("drive.mcap"), "drive", ())

    return choose


def cloud_of(sensor: SensorModel) -> np.ndarray:
    """Points of a turn in a room, some firings without a return."""
    rng = np.random.default_rng(0)
    firings = 4000 // sensor.n_lasers + 20
    laser = np.tile(np.arange(sensor.n_lasers), firings)
    tick = np.repeat(np.arange(firings) * (sensor.ticks_per_turn // firings), sensor.n_lasers)
    count = np.rint((6.0 + 3.0 * np.sin(tick / 3000) + rng.normal(0, 0.05, len(tick))) / sensor.count)
    points = driven(sensor, laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    points[rng.random(len(points)) < 0.1] = 0
    return points


@pytest.mark.parametrize("name", [name for name in SHIPPED if name != OTHERWISE])
def test_finds_every_shipped_sensor(name: str, chosen) -> None:
    assert chosen(cloud_of(load_sensor(name))) == (name, 1.0, 0.0, None)


@pytest.mark.parametrize("name", ["xt32", "vlp32c", "pandar64"])
def test_finds_another_unit_whose_lasers_look_elsewhere(name: str, chosen) -> None:
    shipped = load_sensor(name)
    assert shipped.driver is not None
    rng = np.random.default_rng(2)
    kind, lasers = shipped.driver, shipped.driver.lasers.astype(np.float64)
    sine = SINES.index(kind.sine)
    aside = np.radians(rng.normal(0, 0.02, len(lasers)))
    elevation = np.arctan2(lasers[:, 1], lasers[:, 0]) + np.radians(rng.normal(0, 0.02, len(lasers)))
    azimuth = lasers[:, 2] if kind.formula == "hesai" else np.arctan2(lasers[:, 3], lasers[:, 2])
    rows = [FORMULAS[kind.formula].row(sine, np.float32(angle)) for angle in azimuth + aside]
    lasers = np.column_stack([np.cos(elevation), np.sin(elevation), np.array(rows)]).astype(np.float32)
    unit = replace(with_driver(shipped, replace(kind, lasers=lasers)), shift=shipped.shift)
    points = cloud_of(unit)
    assert share_on(shipped, points) < 0.1
    found = chosen(points)
    assert found[:3] == (name, pytest.approx(1.0, abs=0.01), 0.0)
    assert found.unit.bit_identical_share > 0.99
    assert found.unit.name == shipped.name
    assert np.abs(found.unit.theta - unit.theta).max() < 1e-6
    of_given = chosen(points, shipped)
    assert of_given.unit.to_json() == found.unit.to_json()
    assert chosen(points, unit) is None


def with_lasers_of(name: str, shipped: SensorModel, formula: str, few: slice, aside: float) -> SensorModel:
    """A sensor that some lasers of a shipped one make by another formula, turned ``aside`` radians."""
    assert shipped.driver is not None
    lasers = shipped.driver.lasers[few].copy()
    lasers[:, 2:] = FORMULAS[formula].row(SINES.index(shipped.driver.sine), np.float32(aside))
    kind = replace(shipped.driver, formula=formula, lasers=lasers)
    zero = np.zeros(len(kind.lasers))
    bare = SensorModel(name, shipped.ticks_per_turn, shipped.count, *[zero] * 5, zero.astype(np.int64))
    return with_driver(bare, kind)


@pytest.mark.parametrize(
    ("shipped", "formula", "few", "aside"),
    [("vlp16", "nebula", slice(None), 0.0), ("qt64", "hesai", slice(0, 64, 4), 0.09)],
)
def test_fits_a_model_where_no_shipped_one_gives_the_floats_back(
    shipped: str, formula: str, few: slice, aside: float, chosen
) -> None:
    """Of a sensor that ships by another driver, points lie on the lattice, but do not come back; some lasers of a shipped one are no unit of it."""
    truth = with_lasers_of("x", load_sensor(shipped), formula, few, aside)
    found = chosen(cloud_of(truth))
    assert found[:3] == (OWN, pytest.approx(1.0, abs=0.01), 0.0)
    assert found.unit.driver.formula == formula
    assert found.unit.n_lasers == truth.n_lasers
    assert found.unit.bit_identical_share > 0.98


def test_a_given_sensor_of_quite_other_lasers_is_left_alone(chosen) -> None:
    points = cloud_of(load_sensor("vlp16"))
    assert chosen(points, load_sensor("vls128")) is None
    assert chosen(points[:0], load_sensor("vls128")) is None


@pytest.mark.parametrize("name", ["vlp16", "xt32", "hdl32e"])
def test_finds_a_sensor_whose_driver_does_not_round_azimuths(name: str, chosen) -> None:
    points = cloud_of(load_sensor(name)).astype(np.float64)
    angle = np.radians(np.random.default_rng(1).uniform(-0.005, 0.005, len(points)))
    c, s = np.cos(angle), np.sin(angle)
    x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    turned = np.stack([x, y, points[:, 2]], axis=1).astype(np.float32)
    found = chosen(turned)
    assert found.name == name
    assert found.share > 0.9
    assert found.within > 0.0


def test_takes_the_default_for_what_it_does_not_know(chosen) -> None:
    unknown = np.random.default_rng(0).uniform(-20, 20, (4000, 3)).astype(np.float32)
    assert chosen(unknown) == (OTHERWISE, 0.0, 0.0, None)
    assert chosen(unknown[:0]) == (OTHERWISE, None, 0.0, None)  # nothing to tell by


RECORDINGS = {
    "vlp16_tier4": "vlp16",
    "hdl32_mrpt": "hdl32e",
    "hesai_xt32m": "xt32m",
    "hesai_at128": OTHERWISE,
}


@pytest.mark.parametrize("name", sorted(RECORDINGS))
def test_takes_the_sensor_of_recordings(name: str, real_data: Path) -> None:
    log = real_data / "sensors" / f"{name}.mcap"
    if not log.is_file():
        pytest.skip(f"{log} is not there")
    assert choose_sensor(log, name, ())[0] == RECORDINGS[name]
