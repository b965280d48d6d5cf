"""The sweep: a scan on its sensor lattice (docs/sensor_lattice.md, sections 1 and 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud


@dataclass(frozen=True, eq=False)
class Sweep:
    """A scan as its sensor measured it; gives the scan back exactly (or within ``step``).

    Returns stand in firing order: ring by ring (laser 0 first), by rising tick within a ring. The
    order of the file follows from them (:mod:`salpcc.stages.lattice.order`). What does not fit the
    lattice is a *stray*: it keeps its place in the file and its float32 values.

    Attributes:
        name, time, frame_id: as in :class:`~salpcc.schemas.scan.Scan`.
        n_points: points of the source scan (strays and dropped ones included).
        motion: ``(6,)`` float64 or None, the inverted motion compensation.
        step: range counts per level; above 1, ``count`` holds levels, decoded at their middle.
        max_error: guaranteed 3-D error in metres; 0.0 is bit-exact. Above 0 there are no corrections.
        laser: ``(M,)`` uint8.
        tick: ``(M,)`` int32 in ``[0, sensor.ticks_per_turn)``, azimuth encoder ticks.
        count: ``(M,)`` int32, range counts (levels of ``step`` counts where step > 1).
        intensity: ``(M,)`` float32.
        millimetre: ``(M,)`` uint8, correction of the 1 mm rounding, ``9 (dx+1) + 3 (dy+1) + dz+1``
            with each of dx, dy, dz in -1, 0, 1 mm; 13 is none. All 13 where ``max_error`` > 0.
        ulp: ``(M,)`` uint8, correction of the last float32 bit, coded alike; 13 is none.
        classes: ``(M,)`` uint8 or None.
        stray_index: ``(S,)`` int64, ascending places of the strays among the kept points in file order.
        stray_points: ``(S, 4)`` float32, x, y, z, intensity of the strays.
        stray_classes: ``(S,)`` uint8 or None.
        labels: ``(M,)`` uint32 or None, as their ``.label`` file has them.
        stray_labels: ``(S,)`` uint32 or None.
        cloud: what else the scan's message held, rows in file order of the kept points, or None.
        source: ``(S,)`` int64, ascending places of the points in the organised cloud that others were taken out of; None where
            it is none, or has returns.
        lead: None, but in the movable layer of a scan ``(T,)`` int64: how many of its returns stand before each stray of
            the static layer in the file. ``stray_index`` then counts the points of both layers
            (:mod:`salpcc.stages.lattice.layers`).
    """

    name: str
    time: int
    frame_id: str
    n_points: int
    motion: NDArray[np.float64] | None
    step: int
    max_error: float
    laser: NDArray[np.uint8]
    tick: NDArray[np.int32]
    count: NDArray[np.int32]
    intensity: NDArray[np.float32]
    millimetre: NDArray[np.uint8]
    ulp: NDArray[np.uint8]
    classes: NDArray[np.uint8] | None
    stray_index: NDArray[np.int64]
    stray_points: NDArray[np.float32]
    stray_classes: NDArray[np.uint8] | None
    cloud: Cloud | None = None
    source: NDArray[np.int64] | None = None
    lead: NDArray[np.int64] | None = None
    labels: NDArray[np.uint32] | None = None
    stray_labels: NDArray[np.uint32] | None = None

    def __len__(self) -> int:
        """Number of kept points, strays included."""
        return len(self.laser) + len(self.stray_index)
