"""The scan: points as recorded, in file order."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud


@dataclass(frozen=True, eq=False, repr=False)
class Scan:
    """One revolution of the sensor as it was recorded.

    Attributes:
        name: stem of the source file, e.g. ``000123``; unique in its sequence.
        points: x, y, z in metres, ``(N, 3)`` float32, file order kept.
        intensity: ``(N,)`` float32.
        time: nanoseconds since the start of the log (or since the epoch where the log says so).
        frame_id: coordinate frame of the points.
        classes: ``(N,)`` uint8 index into :data:`salpcc.schemas.labels.CLASSES`, or None.
        labels: ``(N,)`` uint32 as the ``.label`` file of the scan has them (class and instance), or None.
        motion: ``(6,)`` float64 ``(v, w)``, the motion during the scan that its compensation
            used, metres and radians per turn (docs/sensor_lattice.md section 2), or None if the points are
            not compensated.
        cloud: what else its message held, where it came from a recorded log. ``intensity`` is then the
            field of that name as float32, zeros without one.
        offset: ``(N,)`` int32, nanoseconds from ``time`` to when each point was measured, where a frame other than the
            recorded one was asked for; else None.
        movable: ``(N,)`` bool, which points the archive holds in its movable layer, or None where all are in one.

    >>> Scan("000123", np.zeros((5, 3), np.float32), np.zeros(5, np.float32), time=1_500_000_000)
    Scan('000123', 5 points, 1.500000 s)
    """

    name: str
    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    time: int = 0
    frame_id: str = "velodyne"
    classes: NDArray[np.uint8] | None = None
    motion: NDArray[np.float64] | None = None
    cloud: Cloud | None = None
    movable: NDArray[np.bool_] | None = None
    labels: NDArray[np.uint32] | None = None
    offset: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def fields(self) -> dict[str, NDArray[np.generic]]:
        """What points have besides x, y, z and float32 intensity, such as ring and time; ``(N,)`` or ``(N, k)`` by name."""
        return self.cloud.fields if self.cloud is not None else {}

    def __repr__(self) -> str:
        beside = [key for key in ("classes", "labels", "motion", "cloud") if getattr(self, key) is not None]
        also = f", with {', '.join(beside)}" if beside else ""
        return f"Scan({self.name!r}, {len(self):,} points, {self.time / 1e9:.6f} s{also})"

    def _repr_html_(self) -> str:
        """Show the extent of each column in a notebook."""
        columns = dict(zip("xyz", self.points.T, strict=True)) | {"intensity": self.intensity}
        rows = "".join(
            f"<tr><td>{name}</td>" + "".join(f"<td>{value:.3f}</td>" for value in _extent(column)) + "</tr>"
            for name, column in columns.items()
            if np.isfinite(column).any()
        )
        head = "<tr><th></th><th>least</th><th>most</th></tr>"
        return f"<p>{escape(repr(self))}</p><table>{head}{rows}</table>"


def _extent(column: NDArray[np.float32]) -> tuple[float, float]:
    finite = column[np.isfinite(column)]
    return float(finite.min()), float(finite.max())
