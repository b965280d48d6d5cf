"""Scan <-> sweep: put every point on the sensor lattice, and get every bit of it back.

    scan --untwist--> raw points --rings, lattice--> (laser, tick, count) + corrections, or a stray

The sweep made here gives its scan back bit for bit; this is checked point by point while it is made,
and a point that would not come back exactly becomes a stray with its own float32 values.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.aim import lies_on
from salpcc.stages.lattice.lasers import assign_lasers
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.list_motion import find_motion
from salpcc.stages.lattice.measure import measure
from salpcc.stages.lattice.motion_search import is_raw, solve_motion
from salpcc.stages.lattice.order import azimuth_keys, file_order, in_order
from salpcc.stages.lattice.publish import points_and_keys
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.untwist import returns, untwist

Places = tuple[NDArray[np.int64], NDArray[np.int64]]  # in the file, of returns and of strays

_T = TypeVar("_T", bound=np.generic)

# A lattice that explains fewer points than this is not the scan's lattice, and strays cost less.
_MIN_SHARE = 0.2
_MIN_POINTS_FOR_MOTION = 200


class _Returns(NamedTuple):
    """Columns of returns in firing order, ``(M,)`` each: their place in the file, and what :class:`~salpcc.schemas.sweep.Sweep` says of them."""

    place: NDArray[np.int64]
    laser: NDArray[np.uint8]
    tick: NDArray[np.int32]
    counts: NDArray[np.int32]
    millimetre: NDArray[np.uint8]
    ulp: NDArray[np.uint8]


@njit(cache=True)
def _room(n: int) -> _Returns:
    return _Returns(
        np.empty(n, np.int64),
        np.empty(n, np.uint8),
        np.empty(n, np.int32),
        np.empty(n, np.int32),
        np.empty(n, np.uint8),
        np.empty(n, np.uint8),
    )


@njit(cache=True)
def _in_firing_order(
    laser: NDArray[np.int16],
    tick: NDArray[np.int32],
    count: NDArray[np.int32],
    millimetre: NDArray[np.int8],
    ulp: NDArray[np.int8],
    key: NDArray[np.float64],
) -> _Returns:
    """Pick the points, given in file order ``(N,)``, that come back to the bit, are the only ones of their firing, and come back in their place."""
    n = len(laser)
    exact, ring, azimuth = np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n)
    m = 0
    for i in range(n):
        exact[m], ring[m], azimuth[m] = i, laser[i], key[i]
        m += (millimetre[i] >= 0) & (ulp[i] >= 0)
    keep = in_order(ring[:m], azimuth[:m])
    # Insertion sort: azimuths rise, so ticks nearly do.
    cell, place = np.empty(m, np.int64), np.empty(m, np.int64)
    found = 0
    for k in range(m):
        if keep[k]:
            i = exact[k]
            of_firing = np.int64(ring[k]) << 32 | np.int64(tick[i])
            j = found
            while j > 0 and cell[j - 1] > of_firing:
                cell[j], place[j] = cell[j - 1], place[j - 1]
                j -= 1
            cell[j], place[j] = of_firing, i
            found += 1
    room = _room(found)
    m = 0
    for k in range(found):
        if k > 0 and cell[k] == cell[k - 1]:
            continue
        i = place[k]
        room.place[m], room.laser[m], room.tick[m], room.counts[m] = i, laser[i], tick[i], count[i]
        room.millimetre[m], room.ulp[m] = millimetre[i], ulp[i]
        m += 1
    return _Returns(
        room.place[:m], room.laser[:m], room.tick[:m], room.counts[:m], room.millimetre[:m], room.ulp[:m]
    )


def _find_motion(
    points: NDArray[np.float32], start: NDArray[np.float64] | None, seek: bool
) -> tuple[bool, NDArray[np.float64] | None]:
    """Tell whether the points' lattice can be had, and the motion to undo for it (None: raw)."""
    if len(points) == 0 or is_raw(points):
        return True, None
    if not seek or len(points) < _MIN_POINTS_FOR_MOTION:
        return False, None
    try:
        motion = solve_motion(points, start)
    except np.linalg.LinAlgError:  # nothing like a turn of a sensor
        motion = None
    return motion is not None, motion


def _all_strays(scan: Scan, motion: NDArray[np.float64] | None) -> Sweep:
    """A sweep without returns; its motion is by place in the list (:mod:`.list_motion`)."""
    return _sweep(scan, motion, _room(0))


def _sweep(scan: Scan, motion: NDArray[np.float64] | None, found: _Returns) -> Sweep:
    """Build the sweep of these returns; the other points are strays."""
    on = found.place
    off = np.ones(len(scan), np.bool_)
    off[on] = False
    stray = np.flatnonzero(off)
    return Sweep(
        name=scan.name,
        time=scan.time,
        frame_id=scan.frame_id,
        n_points=len(scan),
        motion=motion,
        step=1,
        max_error=0.0,
        laser=found.laser,
        tick=found.tick,
        count=found.counts,
        intensity=scan.intensity[on],
        millimetre=found.millimetre,
        ulp=found.ulp,
        classes=None if scan.classes is None else scan.classes[on],
        stray_index=stray,
        stray_points=np.column_stack([scan.points[stray], scan.intensity[stray]]),
        stray_classes=None if scan.classes is None else scan.classes[stray],
        cloud=scan.cloud,
        labels=None if scan.labels is None else scan.labels[on],
        stray_labels=None if scan.labels is None else scan.labels[stray],
    )


def scan_to_sweep(
    scan: Scan, sensor: SensorModel, start: NDArray[np.float64] | None = None, seek: bool = True
) -> Sweep:
    """Put a scan on its sensor lattice, losslessly.

    Never fails: what does not fit becomes a stray, and a foreign scan is nothing but strays.

    Args:
        start: motion of the scan before, from which the inversion starts.
        seek: what takes seconds: of a recorded message, the motion of a turn; of a scan without returns, one by place in the list.

    >>> from salpcc.stages.lattice.sensor_model import load_sensor
    >>> points = np.array([[10, 0, 0.5], [0, 4, -1.9]], np.float32)
    >>> sweep = scan_to_sweep(Scan("000000", points, np.zeros(2, np.float32)), load_sensor("hdl64e"))
    >>> np.array_equal(sweep_to_scan(sweep, load_sensor("hdl64e")).points, points)
    True
    """
    points = np.ascontiguousarray(scan.points, dtype=np.float32)
    # Not rounded to 1 mm: no returns of this lattice, but the coder of strays knows it.
    if lies_on(sensor, points):
        return _all_strays(scan, None)
    some = returns(points)  # what is no return lies on any lattice
    locked, motion = _find_motion(points if some.all() else points[some], start, seek or scan.cloud is None)
    if not locked:
        return _all_strays(scan, find_motion(points, sensor) if seek else None)

    raw, azimuth, ulp, explained = untwist(points, motion)
    laser = assign_lasers(sensor, raw, explained)
    tick, count, millimetre, key = measure(sensor, laser, raw, azimuth)
    found = _in_firing_order(laser, tick, count, millimetre, ulp, key)
    if len(found.place) < _MIN_SHARE * len(scan):
        return _all_strays(scan, find_motion(points, sensor) if seek else None)
    return _sweep(scan, motion, found)


def return_points(sweep: Sweep, sensor: SensorModel) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the points ``(M, 3)`` of the returns in firing order, and their order in the file."""
    points, keys = points_and_keys(sweep, sensor)
    return points, file_order(sweep.laser, keys)


def middle_counts(sweep: Sweep) -> NDArray[np.float64]:
    """Return the counts ``(M,)`` in the middle of the sweep's levels."""
    return sweep.count.astype(np.float64) * sweep.step + (sweep.step - 1) / 2


def return_places(sweep: Sweep) -> NDArray[np.int64]:
    """Return the places of the returns ``(M,)`` among the kept points, ascending."""
    free = np.ones(len(sweep), np.bool_)
    free[sweep.stray_index] = False
    return np.flatnonzero(free)


def source_places(sweep: Sweep, sensor: SensorModel) -> Places:
    """Return the places in file order of the returns ``(M,)`` and of the strays ``(S,)``."""
    model = unproject(sensor, sweep.laser, sweep.tick, middle_counts(sweep))
    places = np.empty(len(sweep.laser), np.int64)
    places[file_order(sweep.laser, azimuth_keys(model))] = return_places(sweep)
    return places, sweep.stray_index


@njit(cache=True, nogil=True)
def _arranged(
    points: NDArray[np.float32],
    intensity: NDArray[np.float32],
    order: NDArray[np.int64],
    stray_index: NDArray[np.int64],
    stray_points: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Put points ``(M, 3)`` and intensities ``(M,)`` in their order on the places that the strays ``(S, 4)`` leave."""
    n = len(order) + len(stray_index)
    put, values = np.empty((n, 3), np.float32), np.empty(n, np.float32)
    begin = 0
    for stray in range(len(stray_index) + 1):
        end = min(stray_index[stray], n) if stray < len(stray_index) else n
        for place in range(begin, end):
            source, to = np.uint64(order[np.uint64(place - stray)]), np.uint64(place)
            for c in range(3):
                put[to, c] = points[source, c]
            values[to] = intensity[source]
        if end < n:
            for c in range(3):
                put[end, c] = stray_points[stray, c]
            values[end] = stray_points[stray, 3]
        begin = end + 1
    return put, values


def sweep_to_scan(sweep: Sweep, sensor: SensorModel) -> Scan:
    """Return the scan of a sweep in file order: exact, or within its ``max_error``."""
    returned, order = return_points(sweep, sensor)
    points, intensity = _arranged(
        returned,
        sweep.intensity,
        order,
        sweep.stray_index,
        np.ascontiguousarray(sweep.stray_points, np.float32),
    )

    def listed(of_returns: NDArray[_T] | None, of_strays: NDArray[_T] | None) -> NDArray[_T] | None:
        if of_returns is None or of_strays is None:
            return None
        values = np.empty(len(sweep), of_returns.dtype)
        values[return_places(sweep)], values[sweep.stray_index] = of_returns[order], of_strays
        return values

    # That of a sweep without returns is by place in the list, which a scan's is not.
    motion = sweep.motion if len(sweep.laser) else None
    classes, labels = listed(sweep.classes, sweep.stray_classes), listed(sweep.labels, sweep.stray_labels)
    about = sweep.name, points, intensity, sweep.time, sweep.frame_id
    return Scan(*about, classes, motion, sweep.cloud, labels=labels)
