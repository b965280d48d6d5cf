"""Refit a sensor model on recorded scans: read, undo the motion, fit, say how well it does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError, UsageError
from salpcc.stages.ingest.calibrate import fit_sensor, share_exact
from salpcc.stages.ingest.motion_search import is_raw, solve_motion
from salpcc.stages.ingest.sensor_model import SensorModel, load_sensor
from salpcc.stages.ingest.sources.velodyne_bin import read_points
from salpcc.stages.ingest.untwist import untwist


@dataclass(frozen=True)
class Calibration:
    """A fitted model, and the shares of points that it and its start give back to the millimetre."""

    model: SensorModel
    scans: int
    left_out: int
    exact_before: float
    exact: float


def calibrate_log(log: Path, start: str, at_most: int, name: str) -> Calibration:
    """Fit a sensor model to the ``.bin`` scans in ``log`` or anywhere below it.

    Args:
        start: sensor model that gives ticks per turn and count size, and is compared with.
        at_most: number of scans to use, evenly spread over all.
        name: of the new model.

    Raises:
        UsageError: no scans there.
        SensorError: the scans are not of one spinning sensor.
    """
    files = sorted(log.rglob("*.bin"))
    if not files:
        raise UsageError(f"{log}: no .bin scans found there or below")
    chosen = [
        files[i] for i in np.unique(np.linspace(0, len(files) - 1, min(at_most, len(files))).astype(int))
    ]
    raw = [points for points in (raw_points_of(file) for file in chosen) if points is not None]
    like = load_sensor(start)
    model = fit_sensor(raw, like, name)
    return Calibration(
        model, len(raw), len(chosen) - len(raw), share_exact(like, raw), share_exact(model, raw)
    )


def raw_points_of(file: Path) -> NDArray[np.int64] | None:
    """Raw points ``(N, 3)`` in mm of one scan, its motion undone; None where that cannot be done."""
    try:
        points, _ = read_points(file)
    except SourceError:
        return None
    if len(points) == 0:
        return None
    motion = None if is_raw(points) else solve_motion(points)
    if motion is None and not is_raw(points):
        return None
    raw, _, explained = untwist(points, motion)
    return raw[explained]
