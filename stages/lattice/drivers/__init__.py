"""Drivers: the arithmetic, in float32, by which a sensor's driver made points of counts and azimuth indices.

One file a formula. Those of Velodyne (two) and Hesai (three) have cosine and sine of the laser's elevation e as float32, and turn the same way: with the range
``d`` and a *bearing* (u, v) of the laser at the azimuth index, every product rounded to float32::

    x = (d cos e) u          y = (d cos e) v          z = d sin e

A tick of the sensor model counts the other way round than an index, so tick T is index ``(STEPS - T) mod STEPS``. The range is
``count * unit``, the product of float32 (``single``) or of float64 rounded once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers import hesai, nebula, ouster, pandar, pandar_degrees, velodyne
from salpcc.stages.lattice.drivers.degrees import angles_of, row_of
from salpcc.stages.lattice.trig import arctan2

FORMULAS: dict[str, ModuleType] = {
    "velodyne": velodyne,
    "hesai": hesai,
    "ouster": ouster,
    "pandar": pandar,
    "nebula": nebula,
    "pandar_degrees": pandar_degrees,
}
# Those with bearings, in the order in which they are tried.
TURNING = ("nebula", "velodyne", "hesai", "pandar", "pandar_degrees")
SINES = ("rounded", "polynomial")  # the kinds of :mod:`.sines`
NO_FORMULA, VELODYNE, HESAI, OUSTER, PANDAR, NEBULA, PANDAR_DEGREES = -1, 0, 1, 2, 3, 4, 5
STEPS = 36_000  # azimuth indices in a turn, unless a driver says otherwise
_MOST_STEPS = 1 << 16
_ROWS = 4  # numbers of a laser
_LARGEST = 1 << 24
_TURN = 360.0  # degrees

F32 = NDArray[np.float32]
Tables = tuple[int, int, bool, F32, F32]


@dataclass(frozen=True, eq=False)
class Driver:
    """A formula and its numbers.

    Attributes:
        formula: one of FORMULAS.
        sine: one of SINES.
        single: counts become metres in float32.
        lasers: ``(L, 4)`` float32: cosine and sine of the elevation, and the two numbers of the formula's ``row``; or
            whole numbers, see :mod:`.ouster`.
        steps: azimuth indices in a turn.
    """

    formula: str
    sine: str
    single: bool
    lasers: F32
    steps: int = STEPS

    @property
    def numbers(self) -> tuple[NDArray[np.float64], ...]:
        """theta, z0, h, phi0, d0 ``(L,)`` of a sensor model that the formula comes to, but for its roundings."""
        if self.formula == "ouster":
            return ouster.numbers(self.lasers)
        zero = np.zeros(len(self.lasers))
        theta = np.array([arctan2(float(sine), float(cosine)) for cosine, sine in self.lasers[:, :2]])
        phi0 = np.array([FORMULAS[self.formula].phase(*row) for row in self.lasers[:, 2:]])
        return theta, zero, zero, phi0, zero

    @cached_property
    def tables(self) -> Tables:
        """What :func:`driver_point` wants."""
        formula, sine = list(FORMULAS).index(self.formula), SINES.index(self.sine)
        if self.formula in TURNING:
            values = FORMULAS[self.formula].table(sine)
        else:
            values = np.zeros((self.steps, 1), np.float32)
        return formula, sine, self.single, values, np.ascontiguousarray(self.lasers)

    def to_document(self) -> dict[str, Any]:
        """As JSON: a laser by two angles in degrees where :mod:`.degrees` has them, else its four numbers by the shortest decimals that read back as they.

        A laser of Ouster's formula that starts where the one before does has its angles only.
        """
        return {
            "formula": self.formula,
            "sine": self.sine,
            "single": self.single,
            "steps": self.steps,
            "lasers": [[_short(value) for value in self._told(k)] for k in range(len(self.lasers))],
        }

    def _told(self, k: int) -> Iterable[Any]:
        laser = self.lasers[k]
        if self.formula in TURNING:
            return angles_of(FORMULAS[self.formula], SINES.index(self.sine), laser) or laser
        return laser[:2] if k and bool((laser[2:] == self.lasers[k - 1, 2:]).all()) else laser

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Driver:
        """Inverse of :meth:`to_document`.

        Raises:
            ValueError, KeyError, TypeError: it is none.
        """
        if document["formula"] not in FORMULAS or document["sine"] not in SINES:
            raise ValueError("a driver that is not known")
        lasers = np.array(_rows(document["formula"], SINES.index(document["sine"]), document["lasers"]))
        sound = lasers.ndim == 2 and lasers.shape[1] == _ROWS and bool((np.abs(lasers) < _LARGEST).all())
        steps = int(document["steps"])
        sound = sound and (1 <= steps <= _MOST_STEPS if document["formula"] == "ouster" else steps == STEPS)
        if not sound:
            raise ValueError("a driver that is not known")
        return cls(
            document["formula"], document["sine"], bool(document["single"]), lasers.astype(np.float32), steps
        )


def _rows(formula: str, sine: int, told: Iterable[Iterable[Any]]) -> list[list[float]]:
    """The four numbers of each laser, of which those may be missing that :meth:`Driver.to_document` leaves out."""
    rows: list[list[float]] = []
    for laser in told:
        numbers = [float(value) for value in laser]
        if len(numbers) == 2 and formula not in TURNING:
            numbers += rows[-1][2:] if rows else []
        elif len(numbers) == 2 and max(map(abs, numbers)) <= _TURN:
            numbers = [float(value) for value in row_of(FORMULAS[formula], sine, *numbers)]
        rows.append(numbers)
    return rows


def _short(value: float) -> float | int:
    text = str(value).removesuffix(".0")
    return int(text) if text.lstrip("-").isdigit() and text != "-0" else float(text)


NO_DRIVER: Tables = (NO_FORMULA, 0, False, np.zeros((1, 2), np.float32), np.zeros((1, _ROWS), np.float32))


@njit(cache=True, error_model="numpy", inline="always")
def range32(single: bool, count: float, unit: float) -> np.float32:
    """Return the range of a count, metres."""
    if single:
        return np.float32(np.float32(count) * np.float32(unit))
    return np.float32(count * unit)


@njit(cache=True, error_model="numpy", inline="always")
def bearing_of(
    formula: int, sine: int, values: F32, index: int, a: np.float32, b: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the bearing of a laser of the row's numbers a and b, by one of the formulas that have it."""
    if formula in (VELODYNE, NEBULA):
        return velodyne.bearing(values, index, a, b)
    if formula in (PANDAR, PANDAR_DEGREES):
        return pandar.bearing(values, index, a, b)
    return hesai.bearing(sine, values, index, a)


@njit(cache=True, error_model="numpy")
def driver_point(
    driver: Tables, laser: int, tick: int, count: float, unit: float
) -> tuple[np.float32, np.float32, np.float32]:
    """Return x, y, z of a laser at a tick (0 <= tick < STEPS), bit for bit as the driver has it where ``count`` is whole."""
    formula, sine, single, values, lasers = driver
    index = len(values) - tick if tick > 0 else 0
    if formula == OUSTER:
        return ouster.point(lasers[laser], tick, len(values), count * unit)
    d = range32(single, count, unit)
    u, v = bearing_of(formula, sine, values, index, lasers[laser, 2], lasers[laser, 3])
    rho = np.float32(d * lasers[laser, 0])
    return np.float32(rho * u), np.float32(rho * v), np.float32(d * lasers[laser, 1])


def measured(
    driver: Driver, unit: float, laser: NDArray[np.int64], tick: NDArray[np.int64], count: NDArray[np.int64]
) -> tuple[F32, F32]:
    """Return what a driver with bearings had before it made points ``(N,)`` of lasers, ticks (0 <= tick < STEPS) and counts: ranges in metres, and azimuths in radians as :mod:`.hesai` has them."""
    whole = (
        count.astype(np.float32) * np.float32(unit) if driver.single else (count * unit).astype(np.float32)
    )
    azimuth = hesai.table(0)[(STEPS - tick) % STEPS, 0]
    if driver.formula == "hesai":
        azimuth = azimuth + driver.lasers[laser, 2]
    return whole, azimuth
