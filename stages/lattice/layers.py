"""Two layers of a scan: a sweep of what stays where it is, one of what may move, and the scan of both.

The file's order follows from both layers' returns as it does from those of one sweep. Strays of the movable layer have
their place among all points; for those of the static layer, which know only static points, the movable layer says how
many of its returns come before (:attr:`salpcc.schemas.sweep.Sweep.lead`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.order import azimuth_keys, file_order
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import middle_counts, return_places, sweep_to_scan

_T = TypeVar("_T", bound=np.generic)


class Layered(NamedTuple):
    """The static layer of a scan, and which points ``(N,)`` of both layers, in file order, are of the movable one."""

    static: Sweep
    movable: NDArray[np.bool_]


def return_keys(sweep: Sweep, sensor: SensorModel) -> NDArray[np.float64]:
    """Return what orders the returns ``(M,)`` of a ring in the file."""
    return azimuth_keys(unproject(sensor, sweep.laser, sweep.tick, middle_counts(sweep)))


def placed(movable: Sweep, static: Sweep, mask: NDArray[np.bool_]) -> Sweep:
    """Return a movable layer with its places among all points; inverse of :func:`alone`.

    Args:
        movable: with places among its own points.
        mask: ``(N,)``, which points of both layers, in file order, are of it.
    """
    mine, theirs = np.flatnonzero(mask), np.flatnonzero(~mask)
    lead = np.searchsorted(mine[return_places(movable)], theirs[static.stray_index])
    return replace(movable, stray_index=mine[movable.stray_index], lead=lead.astype(np.int64))


def alone(movable: Sweep, mask: NDArray[np.bool_]) -> Sweep:
    """Return a movable layer with places among its own points; inverse of :func:`placed`."""
    return replace(movable, stray_index=(np.cumsum(mask) - 1)[movable.stray_index], lead=None)


def movable_mask(static: Sweep, movable: Sweep, sensor: SensorModel) -> NDArray[np.bool_]:
    """Mark which points ``(N,)`` of both layers, in file order, are of the movable one.

    Raises:
        ArchiveError: places that cannot be.
    """
    assert movable.lead is not None
    n_static = len(static.laser)
    laser = np.concatenate([static.laser, movable.laser])
    firing = np.argsort(
        laser.astype(np.int64) << 32 | np.concatenate([static.tick, movable.tick]), kind="stable"
    )
    keys = np.concatenate([return_keys(static, sensor), return_keys(movable, sensor)])
    of_movable = firing[file_order(laser[firing], keys[firing])] >= n_static
    before = np.empty(
        len(static), np.int64
    )  # returns of the movable layer before each point of the static one
    before[return_places(static)] = np.cumsum(of_movable)[~of_movable]
    before[static.stray_index] = movable.lead
    known = np.concatenate([[0], before, [len(movable.laser)]])
    require_sound((np.diff(known) >= 0).all())
    mask = np.ones(len(static) + len(movable), np.bool_)
    listed = np.delete(np.arange(len(mask)), movable.stray_index)
    mask[listed[np.arange(len(static)) + before]] = False
    return mask


def both(
    static: Sweep,
    movable: Sweep,
    sensor: SensorModel,
    scan_of: Callable[[Sweep], Scan] | None = None,
) -> Scan:
    """Return the scan of both layers, its points in file order.

    Args:
        scan_of: makes a scan of each layer; None is :func:`~.sweep.sweep_to_scan`.
    """
    mask = movable_mask(static, movable, sensor)
    layers = static, alone(movable, mask)
    a, b = (scan_of(layer) if scan_of else sweep_to_scan(layer, sensor) for layer in layers)
    classes = None
    if a.classes is not None and b.classes is not None:
        classes = merged(mask, a.classes, b.classes)
    labels = offset = None
    if a.labels is not None and b.labels is not None:
        labels = merged(mask, a.labels, b.labels)
    if a.offset is not None and b.offset is not None:
        offset = merged(mask, a.offset, b.offset)
    cloud = a.cloud
    if a.cloud is not None and b.cloud is not None:
        rest, whole = merged(mask, a.cloud.rest, b.cloud.rest), len(mask) == static.n_points
        loose = (a.cloud.loose or b.cloud.loose) if whole else b""
        cloud = replace(a.cloud, rest=rest, loose=loose, whole=whole)
    return replace(
        a,
        points=merged(mask, a.points, b.points),
        intensity=merged(mask, a.intensity, b.intensity),
        classes=classes,
        motion=a.motion if a.motion is not None else b.motion,
        cloud=cloud,
        movable=mask,
        labels=labels,
        offset=offset,
    )


def merged(mask: NDArray[np.bool_], static: NDArray[_T], movable: NDArray[_T]) -> NDArray[_T]:
    """Put the values of both layers in file order, those of points that ``mask (N,)`` marks from the movable one."""
    out = np.empty((len(mask), *static.shape[1:]), static.dtype)
    out[~mask], out[mask] = static, movable
    return out
