"""Segment: label every return, drop what the task does not keep, quantise what it keeps."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.shards import KEPT, sweeps_to_table, table_to_sweeps
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import source_places
from salpcc.stages.segment.labelling import label_gop
from salpcc.stages.segment.task import keep, quantise
from salpcc.stages.segment.to_grid import to_grid

VERSION = 6


def run(table: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a SWEEP table into a TASK table (profile ``paper``: a GRID_TASK table)."""
    sensor = load_sensor(config.sensor)
    sweeps, dropped = [], []
    for labelled in label_gop(table_to_sweeps(table), sensor, config):
        task = labelled if config.keep_movable else drop_movable(labelled, sensor)
        dropped.append(None if config.keep_movable else dropped_classes(labelled, sensor))
        bound = None if config.profile == "paper" else config.max_error
        sweeps.append(task if bound is None else quantise(task, sensor, bound))
    tasks = sweeps_to_table(sweeps, dropped)
    return to_grid(tasks, sensor, config) if config.profile == "paper" else tasks


def drop_movable(sweep: Sweep, sensor: SensorModel) -> Sweep:
    """Return the sweep without its movable returns and strays."""
    assert sweep.classes is not None and sweep.stray_classes is not None
    return keep(
        sweep,
        sensor,
        GROUP_OF_CLASS[sweep.classes] != MOVABLE,
        GROUP_OF_CLASS[sweep.stray_classes] != MOVABLE,
    )


def dropped_classes(sweep: Sweep, sensor: SensorModel) -> NDArray[np.uint8]:
    """Return what :func:`drop_movable` drops of a sweep: the class of each such point in file order, else KEPT."""
    assert sweep.classes is not None and sweep.stray_classes is not None
    on, off = source_places(sweep, sensor)
    classes = np.empty(len(sweep), np.uint8)
    classes[on], classes[off] = sweep.classes, sweep.stray_classes
    return np.where(GROUP_OF_CLASS[classes] == MOVABLE, classes, np.uint8(KEPT))
