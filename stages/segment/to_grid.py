"""Put what the task keeps on the uniform grid: the ``paper`` profile's way to quantise."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid_shards import grids_to_table
from salpcc.schemas.shards import table_to_sweeps
from salpcc.stages.ingest.paper_grid import row_elevations, scan_to_grid
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import sweep_to_scan


def to_grid(task: pa.Table, sensor: SensorModel, config: RunConfig) -> pa.Table:
    """Turn a lossless TASK table of a GOP into its GRID_TASK table; points that collide are lost."""
    sweeps = table_to_sweeps(task)
    scans = [sweep_to_scan(sweep, sensor) for sweep in sweeps]
    elevation = row_elevations([scan.points for scan in scans])
    grids = [
        scan_to_grid(scan, config.accuracy, elevation, sweep.n_points)
        for scan, sweep in zip(scans, sweeps, strict=True)
    ]
    return grids_to_table(grids, task)
