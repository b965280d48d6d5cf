"""What the task keeps, and how finely: drop classes, quantise to a guaranteed error.

Both happen before prediction, so what the decoder will have is known at once and nothing drifts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.lattice import NO_CORRECTION, unproject
from salpcc.stages.ingest.order import azimuth_keys, in_order
from salpcc.stages.ingest.point_cloud import coordinate_rounding
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.ingest.sweep import middle_counts, source_places, sweep_to_scan
from salpcc.stages.ingest.untwist import twist
from salpcc.stages.residual_code.stray_coder import snap

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
    source = sweep_to_scan(sweep, sensor)
    on, off = source_places(sweep, sensor)
    step = counts_per_level(max_error, sensor.count)
    coarse = replace(sweep, step=step, max_error=max_error, count=(sweep.count // step).astype(np.int32))
    model = unproject(sensor, sweep.laser, sweep.tick, middle_counts(coarse))
    points = (model if sweep.motion is None else twist(model, sweep.motion)).astype(np.float32)
    error = np.sqrt(((points.astype(np.float64) - source.points[on]) ** 2).sum(axis=1))
    fits = error <= max_error
    # Coarser ranges turn a few points past their neighbours in azimuth: find those in file order.
    by_file = np.argsort(on, kind="stable")
    candidates = by_file[fits[by_file]]
    in_place = in_order(sweep.laser[candidates].astype(np.int64), azimuth_keys(model)[candidates])
    fits[candidates[~in_place]] = False

    none = np.full(int(fits.sum()), NO_CORRECTION, np.uint8)
    stray = np.sort(np.concatenate([off, on[~fits]]))
    classes = source.classes
    return replace(
        coarse,
        laser=sweep.laser[fits],
        tick=sweep.tick[fits],
        count=coarse.count[fits],
        intensity=sweep.intensity[fits],
        millimetre=none,
        ulp=none,
        classes=None if sweep.classes is None else sweep.classes[fits],
        stray_index=stray,
        stray_points=np.column_stack(
            [snap(source.points[stray], max_error, sensor, moved), source.intensity[stray]]
        ),
        stray_classes=None if classes is None else classes[stray],
    )
