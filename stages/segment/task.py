"""What the task keeps, and how finely: drop classes, quantise to a guaranteed error.

Both happen before prediction, so what the decoder will have is known at once and nothing drifts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.point_cloud import coordinate_rounding
from salpcc.stages.lattice.lattice import NO_CORRECTION, unproject
from salpcc.stages.lattice.order import azimuth_keys, in_order
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import (
    middle_counts,
    return_places,
    return_points,
    source_places,
    sweep_to_scan,
)
from salpcc.stages.lattice.untwist import twist
from salpcc.stages.strays.stray_coder import snap

# Half the diagonal of the 1 mm cube that the published points were rounded in.
_ROUNDING = 0.000867


def keep(sweep: Sweep, sensor: SensorModel, kept: NDArray[np.bool_], stray_kept: NDArray[np.bool_]) -> Sweep:
    """Return the sweep with the marked returns ``(M,)`` and strays ``(S,)`` only.

    Places of strays count kept points; ``n_points`` goes on counting the source's.
    """
    on, off = source_places(sweep, sensor)
    stays = np.zeros(len(sweep), np.bool_)
    stays[on[kept]] = True
    stays[off[stray_kept]] = True
    return replace(
        sweep,
        laser=sweep.laser[kept],
        tick=sweep.tick[kept],
        count=sweep.count[kept],
        intensity=sweep.intensity[kept],
        millimetre=sweep.millimetre[kept],
        ulp=sweep.ulp[kept],
        classes=None if sweep.classes is None else sweep.classes[kept],
        stray_index=(np.cumsum(stays) - 1)[off[stray_kept]],
        stray_points=sweep.stray_points[stray_kept],
        stray_classes=None if sweep.stray_classes is None else sweep.stray_classes[stray_kept],
        cloud=sweep.cloud and sweep.cloud.keep(stays),
    )


def counts_per_level(max_error: float, count: float) -> int:
    """Return how many range counts one level may span for a 3-D error of ``max_error`` metres.

    A level of ``step`` counts decodes to its middle, at most ``(step - 1) / 2`` counts off; the rest of
    the bound pays for the 1 mm rounding of the published points.
    """
    return max(1, int(np.floor(2.0 * (max_error - _ROUNDING) / count + 1.0 + 1e-9)))


@njit(cache=True)
def _distances(points: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[np.float64]:
    """Distance of each of the points ``(M, 3)`` to its twin."""
    distances = np.empty(len(points))
    for i in range(len(points)):
        square = 0.0
        for c in range(3):
            off = np.float64(points[i, c]) - np.float64(others[i, c])
            square += off * off
        distances[i] = np.sqrt(square)
    return distances


def quantise(sweep: Sweep, sensor: SensorModel, max_error: float) -> Sweep:
    """Return a lossless sweep quantised so that no point is farther than ``max_error`` from its source.

    A return that would be farther, or out of its place in the file, becomes a stray. A bound below the
    1 mm rounding of the published points is met by staying lossless. So is one that float64 coordinates
    of a recorded cloud eat up when they become float32; else it is made tighter by as much.
    """
    if sweep.cloud is not None:
        rounding = coordinate_rounding(sweep_to_scan(sweep, sensor))
        if not rounding <= max_error / 2:
            return sweep
        max_error -= rounding
    if max_error < _ROUNDING and len(sweep.laser):
        return sweep
    moved = sweep.motion if len(sweep.laser) == 0 else None
    source, by_file = return_points(sweep, sensor)
    step = counts_per_level(max_error, sensor.count)
    coarse = replace(sweep, step=step, max_error=max_error, count=(sweep.count // step).astype(np.int32))
    model = unproject(sensor, sweep.laser, sweep.tick, middle_counts(coarse))
    points = (model if sweep.motion is None else twist(model, sweep.motion)).astype(np.float32)
    fits = _distances(points, source) <= max_error
    # Coarser ranges turn a few points past their neighbours in azimuth: find those in file order.
    candidates = by_file[fits[by_file]]
    in_place = in_order(sweep.laser[candidates].astype(np.int64), azimuth_keys(model)[candidates])
    fits[candidates[~in_place]] = False

    none = np.full(int(fits.sum()), NO_CORRECTION, np.uint8)
    lost = np.flatnonzero(~fits)
    places = np.empty(len(fits), np.int64)
    places[by_file] = return_places(sweep)
    stray = np.concatenate([sweep.stray_index, places[lost]])
    in_turn = np.argsort(stray, kind="stable")
    stray_points = np.concatenate(
        [sweep.stray_points, np.column_stack([source[lost], sweep.intensity[lost]])]
    )[in_turn]
    stray_points[:, :3] = snap(stray_points[:, :3], max_error, sensor, moved)
    classes = None
    if sweep.classes is not None and sweep.stray_classes is not None:
        classes = np.concatenate([sweep.stray_classes, sweep.classes[lost]])[in_turn]
    return replace(
        coarse,
        laser=sweep.laser[fits],
        tick=sweep.tick[fits],
        count=coarse.count[fits],
        intensity=sweep.intensity[fits],
        millimetre=none,
        ulp=none,
        classes=None if sweep.classes is None else sweep.classes[fits],
        stray_index=stray[in_turn],
        stray_points=stray_points,
        stray_classes=classes,
    )
