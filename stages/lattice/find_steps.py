"""The steps that a sensor measures in: how finely a turn is divided, and what a range count is.

Azimuths that are whole ticks have a sharp line at that many per turn in their spectrum, the harmonics of which are multiples;
so have ranges at the size of a count. Lasers differ by a constant each, so they are looked at one by one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST_TICKS = 1 << 16
NOMINAL_TICKS, NOMINAL_COUNT = (
    36_000,
    0.001,
)  # where points show no steps: fine enough for any bound that is asked
COUNTS = (0.01, 0.008, 0.006, 0.005, 0.004, 0.003, 0.002, 0.001)  # metres
LEVERS = np.arange(-0.06, 0.0601, 0.004)  # metres
_FEWEST_TICKS = 360
_CELLS = 1 << 18
_LINE = 0.3  # of full coherence: a line, not noise
_AS_SHARP = 2.0  # times what the sharpest line leaves
_LASERS = 8  # looked at
_LEAST, _LEAST_RANGES = 200, 50  # points of a laser

F64 = NDArray[np.float64]


def find_ticks(lasers: list[F64]) -> tuple[int, float]:
    """Return ticks per turn of points ``(N, 3)`` per laser, and how coherent azimuths are at that, 0 to 1.

    Where they are not, it is NOMINAL_TICKS.
    """
    scores = np.zeros(MOST_TICKS + 1)
    chosen = _largest(lasers, _LEAST)
    for points in chosen:
        rho = np.hypot(points[:, 0], points[:, 1])
        far = points[rho >= np.median(rho)]
        rho = np.hypot(far[:, 0], far[:, 1])
        azimuth = np.arctan2(far[:, 1], far[:, 0])
        best = np.zeros(MOST_TICKS + 1)
        for lever in LEVERS:
            turned = (azimuth - np.arcsin(np.clip(lever / rho, -1, 1))) / (2 * np.pi) % 1.0
            lines = np.fft.rfft(np.bincount((turned * _CELLS).astype(np.int64) % _CELLS, minlength=_CELLS))
            best = np.maximum(best, np.abs(lines[: MOST_TICKS + 1]) / len(far))
        scores += best / len(chosen)
    scores[:_FEWEST_TICKS] = 0.0
    if not chosen or scores.max() < _LINE:
        return NOMINAL_TICKS, 0.0
    # What azimuths are off by, in turns: firings at a steady pace make a line, too, but they are farther from it.
    sharp = np.where(scores > _LINE, scores, 1e-9)
    off = np.sqrt(-2.0 * np.log(np.minimum(sharp, 1.0 - 1e-12))) / np.maximum(np.arange(MOST_TICKS + 1), 1)
    off[scores <= _LINE] = np.inf
    ticks = int(np.argmax(np.where(off <= _AS_SHARP * off.min(), scores, 0.0)))
    return ticks, float(scores[ticks])


def find_count(ranges: list[F64]) -> tuple[float, float]:
    """Return metres per count of ranges ``(N,)`` per laser, and how coherent they are at that, 0 to 1.

    Where they are not, it is NOMINAL_COUNT.
    """
    chosen = _largest(ranges, _LEAST_RANGES)
    if not chosen:
        return NOMINAL_COUNT, 0.0
    scores = np.array(
        [np.mean([np.abs(np.exp(2j * np.pi * d / count).mean()) for d in chosen]) for count in COUNTS]
    )
    if scores.max() < _LINE:
        return NOMINAL_COUNT, 0.0
    largest = int(np.flatnonzero(scores >= 0.6 * scores.max())[0])
    return COUNTS[largest], float(scores[largest])


def _largest(lasers: list[F64], least: int) -> list[F64]:
    """Those with the most points, if they are enough."""
    return [p for p in sorted(lasers, key=len, reverse=True)[:_LASERS] if len(p) >= least]
