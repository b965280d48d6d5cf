"""What surfaces do to the beam: brightness, texture, roughness, transparency.

The numbers are tuned to the per-class intensity of 55 labelled SemanticKITTI scans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Material(NamedTuple):
    """One surface.

    ``brightness`` is the mean intensity at 12 m, ``grain`` its deviation from point to point and
    ``patch`` from place to place, ``rough`` the depth of the surface in metres, ``lost`` the share
    of beams that never come back, ``gloss`` the power of the cosine of incidence in the brightness,
    ``blank`` the share of beams that come back with zero intensity.
    """

    name: str
    brightness: float
    grain: float
    patch: float
    rough: float
    lost: float
    gloss: float
    blank: float


MATERIALS: tuple[Material, ...] = (
    Material("asphalt", 0.28, 0.028, 0.040, 0.0, 0.002, 0.0, 0.012),
    Material("paving", 0.31, 0.028, 0.035, 0.001, 0.002, 0.0, 0.008),
    Material("marking", 0.45, 0.050, 0.060, 0.0, 0.003, 0.0, 0.005),
    Material("grass", 0.38, 0.070, 0.040, 0.008, 0.004, 0.0, 0.003),
    Material("plaster", 0.46, 0.070, 0.060, 0.003, 0.010, 0.3, 0.025),
    Material("window", 0.28, 0.150, 0.050, 0.004, 0.200, 1.0, 0.12),
    Material("wood", 0.36, 0.080, 0.060, 0.004, 0.010, 0.3, 0.05),
    Material("leaf", 0.48, 0.130, 0.050, 0.020, 0.020, 0.3, 0.03),
    Material("bark", 0.37, 0.120, 0.050, 0.008, 0.010, 0.4, 0.06),
    Material("metal", 0.36, 0.120, 0.060, 0.0, 0.040, 0.8, 0.2),
    Material("sign", 0.60, 0.130, 0.100, 0.0, 0.010, 0.5, 0.03),
    Material("paint", 0.42, 0.060, 0.050, 0.0, 0.020, 1.0, 0.22),
    Material("glass", 0.14, 0.120, 0.020, 0.003, 0.550, 1.0, 0.6),
    Material("tyre", 0.06, 0.050, 0.020, 0.002, 0.040, 0.3, 0.5),
    Material("lamp", 0.75, 0.150, 0.100, 0.0, 0.020, 0.3, 0.1),
    Material("cloth", 0.55, 0.110, 0.060, 0.004, 0.010, 0.2, 0.02),
    Material("skin", 0.40, 0.080, 0.020, 0.002, 0.010, 0.2, 0.02),
    Material("tarpaulin", 0.52, 0.050, 0.050, 0.002, 0.010, 0.5, 0.06),
)

NAMES: dict[str, int] = {m.name: i for i, m in enumerate(MATERIALS)}


def column(field: str) -> NDArray[np.float64]:
    """Return one property of all materials as a table ``(len(MATERIALS),)``."""
    return np.array([getattr(m, field) for m in MATERIALS], np.float64)
