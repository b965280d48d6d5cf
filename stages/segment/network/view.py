"""How a cloud of any sensor is laid before the network, which has only seen one sensor on the roof of one car.

Others ride higher or lower, or count brightness in units of their own. What the network asks of a point, how far above
or below the sensor it is and how bright, is brought to what it has learned; clouds like those it learned from stay as
they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.ground_height import cell_minima, opened
from salpcc.stages.segment.network.range_image import in_reach

F32 = NDArray[np.float32]

_GROUND = -1.75  # metres: where the network has seen the ground near the sensor, within 0.3 m
_ALIKE = 0.3
_AROUND = 30  # cells of 1 m that the ground is looked for in
_MIDDLE = 0.28  # median intensity of its scans, as a fraction


@dataclass(frozen=True)
class View:
    """What is done to a cloud before it is laid on the grid.

    Attributes:
        lift: metres added to z.
        brightness: factor of intensities.
    """

    lift: float = 0.0
    brightness: float = 1.0

    @property
    def unlit(self) -> bool:
        """Whether there are no intensities that tell anything."""
        return self.brightness == 0


AS_IT_IS = View()


@njit(cache=True)
def _returns(points: F32) -> NDArray[np.bool_]:
    """Tell which points ``(N, 3)`` are returns."""
    seen = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        seen[i] = in_reach(np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2]))
    return seen


def view_of(clouds: Sequence[tuple[F32, F32]]) -> View:
    """Return the view of consecutive scans of one sensor, given as points ``(N, 3)`` and intensities ``(N,)``.

    The ground is the middle of the lowest returns around the sensor, the middle of all scans. Intensities beyond 1
    are counts, whose unit every sensor has to itself: their median becomes that of the network's scans. Intensities
    that are all the same tell nothing and become 0, which the network knows as none.
    """
    heights = [height for points, _ in clouds if (height := _ground_near(points)) is not None]
    lift = _GROUND - float(np.median(heights)) if heights else 0.0
    return View(lift if abs(lift) > _ALIKE else 0.0, _brightness([intensity for _, intensity in clouds]))


def _ground_near(points: F32) -> float | None:
    lowest = cell_minima(points, _returns(points), _AROUND)
    seen = np.isfinite(lowest)
    return float(np.median(opened(lowest)[seen])) if seen.any() else None


def _brightness(intensities: Sequence[F32]) -> float:
    ends = [(np.nanmin(one), np.nanmax(one)) for one in intensities if not np.isnan(one).all()]
    least, most = (min(e[0] for e in ends), max(e[1] for e in ends)) if ends else (0.0, 0.0)
    if not least < most:
        return 0.0
    if most <= 1:
        return 1.0
    return _MIDDLE / float(np.median(np.concatenate([one[one > 0] for one in intensities])))
