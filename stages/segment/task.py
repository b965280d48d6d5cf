"""What the task keeps, and how finely: drop classes, quantise to a guaranteed error.

Both happen before prediction, so what the decoder will have is known at once and nothing drifts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.point_cloud import coordinate_rounding
from salpcc.stages.lattice.aim import lies_on
from salpcc.stages.lattice.coarser import ROUNDING, coarser
from salpcc.stages.lattice.lattice import NO_CORRECTION
from salpcc.stages.lattice.layers import placed, return_keys
from salpcc.stages.lattice.order import file_order, in_order
from salpcc.stages.lattice.publish import points_and_keys
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import (
    Places,
    return_places,
    source_places,
    sweep_to_scan,
)
from salpcc.stages.lists.aimed.aimed_layers import Among
from salpcc.stages.lists.list_plan import snap

_T = TypeVar("_T", bound=np.generic)

_COARSE = 0.05  # metres
_BESIDE_AXIS, _MOST = 50.0, 0.9  # millimetres that beams start from the axis; of the returns


def keep(
    sweep: Sweep,
    sensor: SensorModel,
    kept: NDArray[np.bool_],
    stray_kept: NDArray[np.bool_],
    places: Places | None = None,
) -> Sweep:
    """Return the sweep with the marked returns ``(M,)`` and strays ``(S,)`` only.

    Places of strays count kept points; ``n_points`` goes on counting the source's.

    Args:
        places: what :func:`~salpcc.stages.lattice.sweep.source_places` says of the sweep, where the caller knows it.
    """
    on, off = places or source_places(sweep, sensor)
    stays = np.zeros(len(sweep), np.bool_)
    here, astray = np.flatnonzero(kept), np.flatnonzero(stray_kept)
    stays[on[here]] = True
    stays[off[astray]] = True
    return replace(
        _some(sweep, here),
        intensity=sweep.intensity[here],
        classes=None if sweep.classes is None else sweep.classes[here],
        stray_index=(np.cumsum(stays) - 1)[off[astray]],
        source=_source(sweep, astray),
        stray_points=sweep.stray_points[astray],
        stray_classes=None if sweep.stray_classes is None else sweep.stray_classes[astray],
        cloud=sweep.cloud and sweep.cloud.keep(stays),
        labels=None if sweep.labels is None else sweep.labels[here],
        stray_labels=None if sweep.stray_labels is None else sweep.stray_labels[astray],
    )


def _source(sweep: Sweep, at: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return the places in their organised cloud of the strays ``at`` of a sweep that is nothing but strays; None of another."""
    if sweep.source is not None:
        return sweep.source[at]
    cloud = sweep.cloud
    organised = cloud is not None and cloud.whole and min(cloud.layout.height, cloud.layout.width) > 1
    return at if organised and len(sweep.laser) == 0 and len(at) < sweep.n_points else None


def _some(sweep: Sweep, at: NDArray[np.int64]) -> Sweep:
    """Return the sweep with the returns ``at`` only: where they lie, not what else is known of them."""
    return replace(
        sweep,
        laser=sweep.laser[at],
        tick=sweep.tick[at],
        count=sweep.count[at],
        millimetre=sweep.millimetre[at],
        ulp=sweep.ulp[at],
    )


def split(
    sweep: Sweep,
    sensor: SensorModel,
    moves: NDArray[np.bool_],
    stray_moves: NDArray[np.bool_],
    bounds: tuple[float | None, float | None] = (None, None),
    places: Places | None = None,
) -> tuple[Sweep, Sweep]:
    """Return the static and the movable layer of a sweep; the marked returns ``(M,)`` and strays ``(S,)`` are movable.

    The static layer is what :func:`keep` leaves, to the bit; :func:`~salpcc.stages.lattice.layers.both` puts them together.

    Args:
        bounds: of each layer's error, metres; None is exact.
        places: as in :func:`keep`.
    """
    on, off = places = places or source_places(sweep, sensor)
    mask = np.zeros(len(sweep), np.bool_)
    mask[on[moves]] = True
    mask[off[stray_moves]] = True
    static = keep(sweep, sensor, ~moves, ~stray_moves, places)
    movable = keep(sweep, sensor, moves, stray_moves, places)
    if sweep.cloud is not None:
        loose = replace(movable.cloud or sweep.cloud, loose=sweep.cloud.loose)
        movable = replace(movable, cloud=loose if mask.any() else None)
    if bounds[0] is not None:
        static = quantise(static, sensor, bounds[0])
    if static.max_error > 0 or bounds[1] is not None:
        theirs = np.flatnonzero(~mask)[source_places(static, sensor)[0]]
        gaps = _gaps(static.laser, return_keys(static, sensor), theirs, movable.laser, on[moves])
        movable = quantise(movable, sensor, bounds[1] or 0.0, gaps)
    return static, placed(movable, static, mask)


def _gaps(
    laser: NDArray[np.uint8],
    keys: NDArray[np.float64],
    places: NDArray[np.int64],
    of: NDArray[np.uint8],
    at: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Keys that returns of the lasers ``of`` ``(M,)`` at the places ``at`` must lie between, ``(2, M)``.

    Args:
        laser, keys, places: of all returns that are known, in any order.
    """
    order = np.argsort(places)
    laser, keys = laser[order], keys[order]
    after = np.searchsorted(places[order], at)
    ends = np.append(keys, 0.0), np.append(laser, 0).astype(np.int64)
    low = np.where((after > 0) & (ends[1][after - 1] == of), ends[0][after - 1], -np.inf)
    high = np.where((after < len(keys)) & (ends[1][after] == of), ends[0][after], np.inf)
    return np.stack([low, high])


def counts_per_level(max_error: float, count: float) -> int:
    """Return how many range counts one level may span for a 3-D error of ``max_error`` metres.

    A level of ``step`` counts decodes to its middle, at most ``(step - 1) / 2`` counts off; the rest of
    the bound pays for the 1 mm rounding of the published points.
    """
    return max(1, int(np.floor(2.0 * (max_error - ROUNDING) / count + 1.0 + 1e-9)))


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


def _distances_are_told(sweep: Sweep, sensor: SensorModel) -> bool:
    """Tell whether the points are on the lattice, to the bit, and a field of their message has their distances in whole millimetres."""
    field = None if sweep.cloud is None else sweep.cloud.range_field
    points = sweep.stray_points[:, :3]
    if sweep.cloud is None or field is None or len(sweep.laser) or not lies_on(sensor, points):
        return False
    told, seen = sweep.cloud.values(field).astype(np.int64), (points != 0).any(axis=1)
    distance = 1000.0 * np.sqrt((points[seen].astype(np.float64) ** 2).sum(axis=1))
    return bool((np.abs(told[seen] - distance) <= _BESIDE_AXIS).mean() > _MOST)


def _is_coarse(sweep: Sweep, max_error: float) -> bool:
    """Tell whether points were float16 and their message tells rings and times, so that they cost least as they are."""
    if sweep.cloud is None or len(sweep.laser) or max_error > _COARSE or sweep.cloud.time_field is None:
        return False
    bits = np.ascontiguousarray(sweep.stray_points[:, :3], np.float32).view(np.int32)
    return sweep.cloud.rings() is not None and bool((bits & 0x1FFF == 0).all())


def quantise(
    sweep: Sweep, sensor: SensorModel, max_error: float, gaps: NDArray[np.float64] | None = None
) -> Sweep:
    """Return a lossless sweep quantised so that no point is farther than ``max_error`` from its source.

    A return that would be farther, or out of its place in the file, becomes a stray. A bound below the
    1 mm rounding of the published points is met by staying lossless. So is one that float64 coordinates
    of a recorded cloud eat up when they become float32; else it is made tighter by as much. Points whose message tells their
    distances exactly stay exact, too: these would give them back, and cost more without them. So do float16 points whose message
    tells lasers and times: their own steps are as coarse.

    Args:
        gaps: ``(2, M)``, between which keys of :func:`~salpcc.stages.lattice.layers.return_keys` the place of each
            return in the file lies, where another layer has returns of the scan, too.
    """
    if sweep.cloud is not None:
        rounding = coordinate_rounding(sweep_to_scan(sweep, sensor))
        max_error = max_error - rounding if rounding <= max_error / 2 else 0.0
        if gaps is None and (_distances_are_told(sweep, sensor) or _is_coarse(sweep, max_error)):
            max_error = 0.0
    exact = max_error == 0 or (max_error < ROUNDING and len(sweep.laser) > 0)
    if exact and gaps is None:
        return sweep
    moved = sweep.motion if len(sweep.laser) == 0 and gaps is None else None
    coarse = sweep
    if exact:
        keys = of_source = return_keys(sweep, sensor)
        fits = np.ones(len(keys), np.bool_)
    else:
        step = counts_per_level(max_error, sensor.count)
        coarse = replace(sweep, step=step, max_error=max_error, count=(sweep.count // step).astype(np.int32))
        fits, of_source, keys = coarser(sweep, coarse, sensor, max_error)
        unsure = np.flatnonzero(~fits)
        source, points = (points_and_keys(_some(s, unsure), sensor)[0] for s in (sweep, coarse))
        fits[unsure] = _distances(points, source) <= max_error
    if gaps is not None:
        fits &= (gaps[0] < keys) & (keys < gaps[1])
    by_file = file_order(sweep.laser, of_source)
    if coarse.step > 1:
        # Coarser ranges turn a few points past their neighbours in azimuth: find those in file order.
        candidates = by_file if fits.all() else by_file[fits[by_file]]
        in_place = in_order(sweep.laser[candidates], keys[candidates])
        fits[candidates[~in_place]] = False

    rank = np.flatnonzero(~fits[by_file])
    lost = by_file[rank]
    if exact and not len(lost):
        return sweep
    kept = np.flatnonzero(fits) if len(lost) else slice(None)
    none = np.full(len(fits) - len(lost), NO_CORRECTION, np.uint8)
    stray = np.concatenate([sweep.stray_index, return_places(sweep)[rank]])
    in_turn = np.argsort(stray, kind="stable")
    source = points_and_keys(_some(sweep, lost), sensor)[0]
    stray_points = np.concatenate([sweep.stray_points, np.column_stack([source, sweep.intensity[lost]])])[
        in_turn
    ]
    if not exact:
        among = None
        if gaps is None and sweep.source is not None and sweep.cloud is not None:
            among = Among.of_source(sweep.n_points, sweep.source, sweep.cloud.layout.width)
        stray_points[:, :3] = snap(stray_points[:, :3], max_error, sensor, moved, among)

    def strays(of_strays: NDArray[_T] | None, of_returns: NDArray[_T] | None) -> NDArray[_T] | None:
        if of_strays is None or of_returns is None:
            return None
        return np.concatenate([of_strays, of_returns[lost]])[in_turn]

    return replace(
        coarse,
        laser=sweep.laser[kept],
        tick=sweep.tick[kept],
        count=coarse.count[kept],
        intensity=sweep.intensity[kept],
        millimetre=sweep.millimetre[kept] if exact else none,
        ulp=sweep.ulp[kept] if exact else none,
        classes=None if sweep.classes is None else sweep.classes[kept],
        stray_index=stray[in_turn],
        stray_points=stray_points,
        stray_classes=strays(sweep.stray_classes, sweep.classes),
        labels=None if sweep.labels is None else sweep.labels[kept],
        stray_labels=strays(sweep.stray_labels, sweep.labels),
    )
