"""The grid sweep: a scan on the uniform range image of the ``paper`` profile (SA-LPCC, eq. (1))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 64, 2000


@dataclass(frozen=True, eq=False)
class GridSweep:
    """What the task keeps of a scan, one range per cell; points that collided are not in it.

    Points stand row by row (top first), by column within a row (azimuth pi first, clockwise).

    Attributes:
        name, time, frame_id: as in :class:`~salpcc.schemas.scan.Scan`.
        n_points: points of the source scan (lost and dropped ones included).
        accuracy: metres per level.
        elevation: ``(64,)`` int16, mean elevation of the points of each row, thousandths of a degree.
        level: ``(64, 2000)`` int32, range over accuracy, rounded; 0 is an empty cell.
        intensity: ``(M,)`` float32 of the filled cells.
        classes: ``(M,)`` uint8 or None.
        motion: ``(6,)`` float64 or None: the motion during the scan, as ingest found it. Not coded.
    """

    name: str
    time: int
    frame_id: str
    n_points: int
    accuracy: float
    elevation: NDArray[np.int16]
    level: NDArray[np.int32]
    intensity: NDArray[np.float32]
    classes: NDArray[np.uint8] | None
    motion: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Number of filled cells."""
        return len(self.intensity)


@dataclass(frozen=True, eq=False)
class GridPrediction:
    """What the frames before say of a grid sweep; all None in the first of a GOP, or where no motion is known.

    Attributes:
        motion: ``(6,)`` int32, from the frame before to this one, in units of
            :data:`salpcc.stages.predict.paper.motion.UNITS`.
        level: ``(64, 2000)`` int32, predicted levels; 0 where there is no prediction.
        spread: ``(64, 2000)`` uint8, 0 to 15, how far off they are expected to be.
    """

    motion: NDArray[np.int32] | None = None
    level: NDArray[np.int32] | None = None
    spread: NDArray[np.uint8] | None = None
