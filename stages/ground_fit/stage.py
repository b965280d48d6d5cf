"""Ground fit: planes of the ground, which the profile ``paper`` predicts from."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid_shards import planes_to_table, table_to_grids
from salpcc.schemas.shards import PLANES
from salpcc.stages.ground_fit.grid_planes import fit_ground

VERSION = 4


def run(task: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a GRID_TASK table into a GRID_PLANES table.

    In the profile ``sensor`` there are none, and the PLANES table is empty: its predictors follow planes by themselves, as
    1/r is linear over a plane (docs/sensor_lattice.md), so nothing would read them.
    """
    if config.profile == "paper":
        return planes_to_table(task.column("name").to_pylist(), [fit_ground(s) for s in table_to_grids(task)])
    return PLANES.empty_table()
