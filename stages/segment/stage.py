"""Segment: label every return, put what may move into a layer of its own or drop it, quantise what is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.shards import KEPT, sweeps_to_table, table_to_sweeps
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import Places, source_places
from salpcc.stages.segment.labelling import label_gop
from salpcc.stages.segment.task import keep, quantise, split
from salpcc.stages.segment.to_grid import to_grid

VERSION = 13


def run(table: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a SWEEP table into a TASK table (profile ``paper``: a GRID_TASK table)."""
    sensor = load_sensor(config.sensor)
    sweeps, movable, dropped, found = [], [], [], []
    bounds = (None, None) if config.profile == "paper" else (config.max_error, config.movable_bound)
    for labelled in label_gop(table_to_sweeps(table), sensor, config):
        asked = not (config.keep_movable and config.stores_classes)
        places = source_places(labelled, sensor) if asked and labelled.classes is not None else None
        classes = None if places is None else point_classes(labelled, places)
        dropped.append(None if config.keep_movable or classes is None else dropped_classes(classes))
        found.append(None if config.stores_classes else classes)
        if config.movable == "layered":
            static, moving = split_movable(labelled, sensor, bounds, places)
            movable.append(moving if config.stores_classes else without_classes(moving))
        else:
            static = labelled if config.keep_movable else drop_movable(labelled, sensor, places)
            static = static if bounds[0] is None else quantise(static, sensor, bounds[0])
        sweeps.append(static if config.stores_classes else without_classes(static))
    tasks = sweeps_to_table(sweeps, dropped, found, movable if config.movable == "layered" else None)
    return to_grid(tasks, sensor, config) if config.profile == "paper" else tasks


def split_movable(
    sweep: Sweep,
    sensor: SensorModel,
    bounds: tuple[float | None, float | None],
    places: Places | None = None,
) -> tuple[Sweep, Sweep]:
    """Return the static and the movable layer of a sweep."""
    assert sweep.classes is not None and sweep.stray_classes is not None
    moves = GROUP_OF_CLASS[sweep.classes] == MOVABLE
    return split(sweep, sensor, moves, GROUP_OF_CLASS[sweep.stray_classes] == MOVABLE, bounds, places)


def without_classes(sweep: Sweep) -> Sweep:
    """Return the sweep without its classes."""
    return replace(sweep, classes=None, stray_classes=None)


def point_classes(sweep: Sweep, places: Places) -> NDArray[np.uint8]:
    """Return the class of each point ``(N,)`` in file order, of a sweep that knows them."""
    assert sweep.classes is not None and sweep.stray_classes is not None
    on, off = places
    classes = np.empty(len(sweep), np.uint8)
    classes[on], classes[off] = sweep.classes, sweep.stray_classes
    return classes


def drop_movable(sweep: Sweep, sensor: SensorModel, places: Places | None = None) -> Sweep:
    """Return the sweep without its movable returns and strays."""
    assert sweep.classes is not None and sweep.stray_classes is not None
    return keep(
        sweep,
        sensor,
        GROUP_OF_CLASS[sweep.classes] != MOVABLE,
        GROUP_OF_CLASS[sweep.stray_classes] != MOVABLE,
        places,
    )


def dropped_classes(classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what :func:`drop_movable` drops of the points ``(N,)``: the class of each such one, else KEPT."""
    return np.where(GROUP_OF_CLASS[classes] == MOVABLE, classes, np.uint8(KEPT))
