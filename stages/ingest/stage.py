"""Ingest: read the scans of one GOP and put them on the sensor lattice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import unreachable
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import stamp, sweeps_to_table
from salpcc.schemas.sweep import Sweep
from salpcc.schemas.work import GopSource, ScanError, ScanRef
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.label_files import labels_that_fit
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep

VERSION = 6
_PATIENCE = 2


def run(gop: GopSource, config: RunConfig) -> pa.Table:
    """Turn the scans of ``gop`` into a SWEEP table; scans that fail are listed as ``errors`` in its facts."""
    source = SOURCES[gop.source]
    project = Projector(load_sensor(config.sensor))
    sweeps: list[Sweep] = []
    errors: list[ScanError] = []
    for ref in gop.scans:
        try:
            scan = source.read(ref, with_labels=config.labels == "given")
            if config.stores_labels and ref.labels is not None:
                scan = replace(scan, labels=labels_that_fit(ref, len(scan)))
            sweeps.append(project(ref.number, scan))
        except Exception as error:
            if unreachable(error):
                raise  # not the scan's: the same command goes on when the way there is mended
            known = isinstance(error, SourceError)
            reason = str(error) if known else f"{ref.path}: {type(error).__name__}: {error}"
            errors.append(ScanError(gop.sequence, ref.name, "ingest", _here(reason, ref)))
    return stamp(sweeps_to_table(sweeps), errors=[vars(error) for error in errors])


def _here(reason: str, ref: ScanRef) -> str:
    """Name files without their folders: a shard says nothing of the machine that wrote it."""
    for path in (ref.path, ref.labels):
        if path is not None:
            reason = reason.replace(path[: path.rfind("/") + 1], "")
    return reason


class Projector:
    """Puts the scans of one GOP on the lattice, one after the other.

    The motion search of a scan starts from its predecessor's, but only where their frame numbers are
    consecutive, and never across GOPs, so a GOP depends on no other. Where a motion of two scans in a row was sought in vain, none is
    sought any more: it takes seconds.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._sensor = sensor
        self._before: int | None = None
        self._motion: NDArray[np.float64] | None = None
        self._in_vain = 0  # scans in a row

    def __call__(self, number: int, scan: Scan) -> Sweep:
        """Project the scan of frame ``number``."""
        follows = self._before is not None and number == self._before + 1
        sweep = scan_to_sweep(
            scan, self._sensor, self._motion if follows else None, self._in_vain < _PATIENCE
        )
        self._in_vain = 0 if len(sweep.laser) or sweep.motion is not None else self._in_vain + 1
        self._before, self._motion = number, sweep.motion
        return sweep
