"""Numbers of a laser as angles: sensors have round ones, and the float32 numbers of a formula follow from these.

With elevation e and azimuth offset o in degrees, and DEGREE = pi / 180 in float64, both angles are ``f32(degrees * DEGREE)``; the row is
cosine and sine of the elevation by the driver's kind of :mod:`.sines`, then what the formula's ``row`` makes of the offset.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers.sines import cosine32, sine32
from salpcc.stages.lattice.trig import arctan2

DEGREE = np.pi / 180.0
_DECIMALS = 9  # more make no shorter text than the row
F32 = NDArray[np.float32]
Row = tuple[np.float32, ...]


def row_of(formula: ModuleType, sine: int, elevation: float, offset: float) -> Row:
    """Return the four numbers of a laser of these angles, degrees."""
    return (*_elevated(sine, elevation), *formula.row(sine, np.float32(offset * DEGREE)))


def angles_of(formula: ModuleType, sine: int, row: F32) -> tuple[float, float] | None:
    """Return elevation and offset in degrees, of as few decimals as do, that make this row ``(4,)``; None where none do."""
    cosine, sine_e, *rest = row
    elevation = _shortest(
        arctan2(float(sine_e), float(cosine)), lambda e: _elevated(sine, e) == (cosine, sine_e)
    )
    # A formula that takes one number takes the offset itself.
    turned = float(rest[0]) if formula.row(sine, rest[0])[0] == rest[0] else arctan2(*map(float, rest[::-1]))
    offset = _shortest(turned, lambda o: formula.row(sine, np.float32(o * DEGREE)) == tuple(rest))
    return None if elevation is None or offset is None else (elevation, offset)


def _elevated(sine: int, elevation: float) -> Row:
    angle = np.float32(elevation * DEGREE)
    return cosine32(sine, angle), sine32(sine, angle)


def _shortest(angle: float, makes: Callable[[float], bool]) -> float | None:
    rounded = (round(angle / DEGREE, decimals) for decimals in range(_DECIMALS))
    return next((degrees for degrees in rounded if makes(degrees)), None)
