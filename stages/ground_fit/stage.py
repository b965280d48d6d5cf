"""Ground fit: one plane per region of ground that has enough points."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid_shards import planes_to_table, table_to_grids
from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS
from salpcc.schemas.shards import PLANES, table_to_sweeps
from salpcc.stages.ground_fit.grid_planes import fit_ground
from salpcc.stages.ground_fit.plane import fit_plane
from salpcc.stages.ground_fit.regions import region_of
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import middle_counts

VERSION = 3
_MIN_POINTS = 30
_ENOUGH = 1000  # points beyond these do not move a plane


def run(task: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a TASK table into a PLANES table: planes ``a x + b y + c z + d = 0`` with c = -1.

    Profile ``paper``: a GRID_TASK table into a GRID_PLANES table.
    """
    if config.profile == "paper":
        return planes_to_table(task.column("name").to_pylist(), [fit_ground(s) for s in table_to_grids(task)])
    sensor = load_sensor(config.sensor)
    rows = []
    for sweep in table_to_sweeps(task):
        if sweep.classes is None:
            continue
        ground = np.flatnonzero(GROUP_OF_CLASS[sweep.classes] == GROUND)
        if not len(ground):
            continue
        counts = middle_counts(sweep)[ground]
        points = unproject(sensor, sweep.laser[ground], sweep.tick[ground], counts)
        region = region_of(points)
        order = np.argsort(region, kind="stable")
        numbers, first = np.unique(region[order], return_index=True)
        for number, inside in zip(numbers, np.split(points[order], first[1:]), strict=True):
            if len(inside) < _MIN_POINTS:
                continue
            a, b, d = (float(value) for value in fit_plane(inside[:: len(inside) // _ENOUGH + 1]))
            rows.append(
                {
                    "name": sweep.name,
                    "region": int(number),
                    "a": a,
                    "b": b,
                    "c": -1.0,
                    "d": d,
                    "n_points": len(inside),
                }
            )
    return pa.Table.from_pylist(rows, schema=PLANES)
