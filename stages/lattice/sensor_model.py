"""The sensor model: five numbers per laser that turn counts and ticks into metres.

docs/sensor_lattice.md, section 1. A model belongs to a sensor, not to a drive: it is fitted once over
many scans (:mod:`salpcc.stages.ingest.calibrate.fit_sensor`), shipped as JSON, and travels in every archive.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SensorError
from salpcc.stages.lattice.drivers import Driver

SENSORS = Path(__file__).parent / "sensors"
_VERSION = 2
_PER_LASER = ("theta", "z0", "h", "phi0", "d0")
_MAX_LASERS = 256
_MAX_TICKS = 1 << 16


@dataclass(frozen=True, eq=False, repr=False)
class SensorModel:
    """A spinning sensor of L lasers.

    Attributes:
        name: what the model was fitted for.
        ticks_per_turn: azimuth encoder ticks in a turn.
        count: metres per range count.
        theta: elevation of each laser's cone, rad, ``(L,)`` float64.
        z0: height of its apex, m.
        h: horizontal lever arm, m.
        phi0: azimuth offset below one tick, rad.
        d0: range offset, m.
        shift: ticks between the common firing and the laser's own azimuth, ``(L,)`` int64.
        driver: the arithmetic that makes points of ticks and counts to the bit, where it is known.
        bit_identical_share: of the returns that it was fitted to, those that it gives back bit for bit, where that was counted.
    """

    name: str
    ticks_per_turn: int
    count: float
    theta: NDArray[np.float64]
    z0: NDArray[np.float64]
    h: NDArray[np.float64]
    phi0: NDArray[np.float64]
    d0: NDArray[np.float64]
    shift: NDArray[np.int64]
    driver: Driver | None = None
    bit_identical_share: float | None = None

    def __repr__(self) -> str:
        return f"SensorModel({self.name!r}, {self.n_lasers} lasers)"

    @property
    def n_lasers(self) -> int:
        return len(self.theta)

    @cached_property
    def parameters(self) -> NDArray[np.float64]:
        """theta, z0, h, phi0, d0 as one ``(L, 5)`` array, for kernels."""
        return np.stack([getattr(self, name) for name in _PER_LASER], axis=1)

    @cached_property
    def digest(self) -> str:
        """Hex SHA-256 of the canonical JSON, the name's text included."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def to_json(self) -> str:
        """Write the model as canonical JSON; floats are written so that they read back exactly."""
        document: dict[str, object] = {
            "version": 1 if self.driver is None else _VERSION,
            "name": self.name,
            "ticks_per_turn": self.ticks_per_turn,
            "count": self.count,
            "shift": self.shift.tolist(),
        }
        if self.driver is None:
            document |= {name: getattr(self, name).tolist() for name in _PER_LASER}
        else:
            document["driver"] = self.driver.to_document()
        if self.bit_identical_share is not None:
            document["bit_identical_share"] = self.bit_identical_share
        lines = [f"{json.dumps(k)}:{json.dumps(v, separators=(',', ':'))}" for k, v in document.items()]
        return "{" + ",\n".join(lines) + "}\n"

    @classmethod
    def from_json(cls, text: str | bytes) -> SensorModel:
        """Read what :meth:`to_json` wrote.

        Raises:
            SensorError: not a sensor model, of a newer version, or with values out of range.
        """
        try:
            document = json.loads(text)
            if document["version"] > _VERSION:
                raise SensorError(f"sensor model version {document['version']} is newer than {_VERSION}")
            driver = Driver.from_document(document["driver"]) if document.get("driver") else None
            numbers = document if driver is None else _numbers_of(driver)
            model = cls(
                name=str(document["name"]),
                ticks_per_turn=int(document["ticks_per_turn"]),
                count=float(document["count"]),
                shift=np.array([int(value) for value in document["shift"]], np.int64),
                driver=driver,
                bit_identical_share=_optional(document.get("bit_identical_share")),
                **{name: np.array([float(v) for v in numbers[name]], np.float64) for name in _PER_LASER},
            )
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise SensorError(
                f"not a sensor model: {type(error).__name__}: {' '.join(str(error).split())}"
            ) from error
        sound = (
            1 <= model.n_lasers <= _MAX_LASERS
            and all(len(getattr(model, name)) == model.n_lasers for name in (*_PER_LASER, "shift"))
            and 1 <= model.ticks_per_turn <= _MAX_TICKS
            and 0 < model.count < 1
            and bool(np.isfinite(model.parameters).all())
            and bool((np.abs(model.parameters) < 10).all())
            and bool((np.abs(model.shift) <= model.ticks_per_turn).all())
            and (
                model.driver is None
                or (len(model.driver.lasers) == model.n_lasers and model.driver.steps == model.ticks_per_turn)
            )
        )
        if not sound:
            raise SensorError(f"sensor model {model.name!r} has values out of range")
        return model


def with_driver(model: SensorModel, driver: Driver) -> SensorModel:
    """Return the model whose five numbers per laser are those of a driver; shifts are 0, and to be found again."""
    return replace(
        model, ticks_per_turn=driver.steps, shift=np.zeros(len(driver.lasers), np.int64), driver=driver, **_numbers_of(driver)
    )  # fmt: skip


def _numbers_of(driver: Driver) -> dict[str, Any]:
    """The five numbers per laser that a driver's formula comes to, but for its roundings."""
    return dict(zip(_PER_LASER, driver.numbers, strict=True))


def _optional(value: object) -> float | None:
    return None if value is None else float(str(value))


def load_sensor(name: str | Path) -> SensorModel:
    """Load a shipped model by name (``hdl64e``) or any model by the path of its JSON file.

    Raises:
        SensorError: no such model, or not readable as one.

    >>> load_sensor("hdl64e").n_lasers
    64
    """
    path = SENSORS / f"{name}.json"
    if not path.is_file():
        path = Path(name)
    try:
        return _parsed(path.read_bytes())
    except SensorError as error:
        raise SensorError(f"{path}: {error}") from error
    except OSError as error:
        shipped = ", ".join(sorted(p.stem for p in SENSORS.glob("*.json")))
        raise SensorError(f"no sensor model {name}: give a JSON file or one of {shipped}") from error


@lru_cache(maxsize=64)
def _parsed(data: bytes) -> SensorModel:
    """Parse what a file holds, once: every stage of every group asks for its sensor."""
    return SensorModel.from_json(data)
