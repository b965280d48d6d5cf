"""Ingest: read the scans of one GOP and put them on the sensor lattice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SourceError
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import stamp, sweeps_to_table
from salpcc.schemas.sweep import Sweep
from salpcc.schemas.work import GopSource, ScanError
from salpcc.stages.ingest.sensor_model import SensorModel, load_sensor
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sweep import scan_to_sweep

VERSION = 1


def run(gop: GopSource, config: RunConfig) -> pa.Table:
    """Turn the scans of ``gop`` into a SWEEP table; scans that cannot be read are listed as ``errors``.

    The motion search of a scan starts from its predecessor's within the GOP only, and only where
    their frame numbers are consecutive: a GOP never depends on another one.
    """
    errors: list[ScanError] = []
    sweeps = list(sweeps_of(_readable(gop, config, errors), load_sensor(config.sensor)))
    return stamp(sweeps_to_table(sweeps), errors=[vars(error) for error in errors])


def sweeps_of(scans: Iterable[tuple[int, Scan]], sensor: SensorModel) -> Iterator[Sweep]:
    """Project numbered scans of one GOP on the lattice, warm-starting the motion from scan to scan."""
    before: int | None = None
    motion = None
    for number, scan in scans:
        start = motion if before is not None and number == before + 1 else None
        sweep = scan_to_sweep(scan, sensor, start)
        yield sweep
        before, motion = number, sweep.motion


def _readable(gop: GopSource, config: RunConfig, errors: list[ScanError]) -> Iterator[tuple[int, Scan]]:
    source = SOURCES[gop.source]
    for ref in gop.scans:
        try:
            scan = source.read(ref, with_labels=config.labels == "given")
        except SourceError as error:
            errors.append(ScanError(gop.sequence, ref.name, "ingest", str(error)))
            continue
        yield ref.number, scan
