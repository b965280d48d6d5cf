"""Bjøntegaard's delta rate: how many percent more (or fewer) bits a codec takes at the same distortion.

Both curves are interpolated as log rate over log distortion by monotone cubics (PCHIP), as the common test
conditions of MPEG do today, and the mean difference over the distortions that both reach is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Curve = Sequence[tuple[float, float]]  # (rate, distortion), both above 0

_SMALLEST_CURVE = 4


def bd_rate(reference: Curve, other: Curve) -> float | None:
    """Return the rate of ``other`` over that of ``reference`` less one, in percent.

    None where a curve has fewer than four points or they share no distortion.
    """
    if min(len(reference), len(other)) < _SMALLEST_CURVE:
        return None
    curves = [_log_curve(reference), _log_curve(other)]
    low = max(distortion[0] for distortion, _ in curves)
    high = min(distortion[-1] for distortion, _ in curves)
    if low >= high:
        return None
    # Imported here: every worker loads this file, and none of them compares curves.
    from scipy.interpolate import PchipInterpolator

    areas = [PchipInterpolator(distortion, rate).integrate(low, high) for distortion, rate in curves]
    return float(100.0 * (np.exp((areas[1] - areas[0]) / (high - low)) - 1.0))


def _log_curve(curve: Curve) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log distortion, ascending and without repeats, and log rate."""
    points = sorted((distortion, rate) for rate, distortion in curve)
    distortion, rate = np.log(np.array(points)).T
    first = np.r_[True, np.diff(distortion) > 0]
    return distortion[first], rate[first]
