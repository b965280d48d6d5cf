"""Encoders that fill their first buffers begin again as decoders begin, so the bytes are those of ample ones."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.grid import GridSweep
from salpcc.schemas.scan import Scan
from salpcc.stages.entropy import buffer
from salpcc.stages.ground_fit.grid_planes import fit_ground
from salpcc.stages.ingest.paper_grid import row_elevations, scan_to_grid
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.paper.frames import predict_gop
from salpcc.stages.residual_code.gop import encode_layers
from salpcc.stages.residual_code.paper.grid_coder import encode_grid
from salpcc.stages.residual_code.paper.grid_streams import GridState
from salpcc.stages.segment.task import split


@pytest.fixture(scope="module")
def scans(make_scan) -> list[Scan]:
    """With classes, strays and corrections, so that no stream is empty."""
    found = []
    for seed in range(2):
        scan = make_scan(seed, stride=16)
        rng = np.random.default_rng(seed)
        points = scan.points.copy()
        points[rng.choice(len(scan), len(scan) // 20, replace=False)] += np.float32(0.0004)
        found.append(replace(scan, points=points, classes=rng.choice(np.array([1, 9], np.uint8), len(scan))))
    return found


def coded_layers(scans: list[Scan], sensor: SensorModel) -> list[bytes]:
    sweeps = [scan_to_sweep(scan, sensor) for scan in scans]
    layers = [split(s, sensor, s.classes == 1, s.stray_classes == 1, (None, None)) for s in sweeps]
    return [payload.data for pair in encode_layers(layers, sensor, "fast") for payload in pair]


def coded_grids(scans: list[Scan]) -> list[bytes]:
    elevation = row_elevations([scan.points for scan in scans])
    sweeps: list[GridSweep] = [scan_to_grid(scan, 0.005, elevation) for scan in scans]
    state = GridState("context")
    pairs = zip(sweeps, predict_gop(sweeps), strict=True)
    return [encode_grid(sweep, fit_ground(sweep), predicted, state).data for sweep, predicted in pairs]


def test_payloads_of_both_profiles_stay(scans, sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    ample = coded_layers(scans, sensor), coded_grids(scans)
    monkeypatch.setattr(buffer, "_PER_VALUE", 0)
    monkeypatch.setattr(buffer, "_SPARE", 16)
    assert (coded_layers(scans, sensor), coded_grids(scans)) == ample
