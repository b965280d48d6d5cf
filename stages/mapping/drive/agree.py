"""Do given poses fit the scans? Compare the way they say was driven with what registration finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.drive.odometry import Registered
from salpcc.stages.mapping.drive.poses import inverse
from salpcc.stages.mapping.drive.registration import rotation_error, translation_error

F64 = NDArray[np.float64]

# Metres apart, and per metre of way; degrees. SuMa's poses of sequences 00 and 04 are 0.05 m off over six scans, those of
# sequences of nearly the same speed 0.57 m. KITTI's own of 00 are 0.73 m off at its start, which is not most groups.
_METRES, _SHARE, _DEGREES = 0.15, 0.05, 1.5


@dataclass(frozen=True)
class Agreement:
    """One group of scans, from its first scan to its last: metres found and given, and whether they agree.

    ``agree`` is None where registration found nothing to compare with.
    """

    scan: str
    found_m: float
    given_m: float
    apart_m: float
    apart_deg: float
    agree: bool | None


def agreement(name: str, poses: F64, found: list[Registered]) -> Agreement:
    """Compare given ``poses`` ``(n, 4, 4)`` of a group with those found; ``name`` is its last scan's."""
    given = inverse(poses[0]) @ poses[-1]
    seen = inverse(found[0].pose) @ found[-1].pose
    metres, degrees = translation_error(seen, given), rotation_error(seen, given)
    way = max(float(np.linalg.norm(seen[:3, 3])), float(np.linalg.norm(given[:3, 3])))
    fits = metres <= _METRES + _SHARE * way and degrees <= _DEGREES
    trusted = all(f.good for f in found)
    return Agreement(
        name,
        float(np.linalg.norm(seen[:3, 3])),
        float(np.linalg.norm(given[:3, 3])),
        metres,
        degrees,
        fits if trusted else None,
    )
