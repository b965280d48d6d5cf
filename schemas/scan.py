"""The scan: points as recorded, in file order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution of the sensor as it was recorded.

    Attributes:
        name: stem of the source file, e.g. ``000123``; unique in its sequence.
        points: x, y, z in metres, ``(N, 3)`` float32, file order kept.
        intensity: ``(N,)`` float32.
        time: nanoseconds since the start of the log (or since the epoch where the log says so).
        frame_id: coordinate frame of the points.
        classes: ``(N,)`` uint8 index into :data:`salpcc.schemas.labels.CLASSES`, or None.
        motion: ``(6,)`` float64 ``(v, w)``, the motion during the scan that its compensation
            used, metres and radians per turn (docs/sensor_lattice.md section 2), or None if the points are
            not compensated.
        cloud: what else its message held, where it came from a recorded log. ``intensity`` is then the
            field of that name as float32, zeros without one.
    """

    name: str
    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    time: int = 0
    frame_id: str = "velodyne"
    classes: NDArray[np.uint8] | None = None
    motion: NDArray[np.float64] | None = None
    cloud: Cloud | None = None

    def __len__(self) -> int:
        return len(self.points)
