"""Write simulated drives as SemanticKITTI lays out its sequences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.simulator.config import SimulationConfig
from salpcc.stages.ingest.simulator.scans import SimulatedScan, simulate_scans
from salpcc.stages.lattice.sensor_model import SensorModel

F64 = NDArray[np.float64]

# Sensor to camera: x ahead, y left, z up becomes x right, y down, z ahead; the offsets are those of a
# camera a foot ahead of and below the sensor.
TR: F64 = np.array(
    [[0.0, -1.0, 0.0, -0.01], [0.0, 0.0, -1.0, -0.07], [1.0, 0.0, 0.0, -0.30], [0, 0, 0, 1]], np.float64
)
_CAMERA = "7.188560000000e+02 0 6.071928000000e+02 {} 0 7.188560000000e+02 1.852157000000e+02 0 0 0 1 0"
_BASELINES = (0.0, -386.1448, 45.38225, -337.2877)


def simulate_sequence(
    config: SimulationConfig,
    root: Path,
    sensor: SensorModel,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Simulate one sequence into ``root/sequences/SS``.

    Writes ``velodyne/000000.bin`` (float32 x, y, z, intensity), ``labels/000000.label`` (uint32),
    ``poses.txt`` (camera convention, first pose the identity), ``calib.txt``, ``times.txt``.
    ``progress`` is called with (scans done, scans in all).
    """
    folder = Path(root) / "sequences" / config.sequence
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    poses, times = [], []
    first: F64 | None = None
    for scan in simulate_scans(config, sensor):
        _write_scan(folder, scan)
        first = scan.pose if first is None else first
        poses.append(TR @ np.linalg.inv(first) @ scan.pose @ np.linalg.inv(TR))
        times.append(scan.time)
        if progress is not None:
            progress(scan.number + 1, config.scans)
    _write_lines(folder / "poses.txt", [" ".join(f"{v:.9e}" for v in p[:3].ravel()) for p in poses])
    _write_lines(folder / "times.txt", [f"{t:.6e}" for t in times])
    cameras = [f"P{i}: {_CAMERA.format(b)}" for i, b in enumerate(_BASELINES)]
    _write_lines(folder / "calib.txt", [*cameras, "Tr: " + " ".join(f"{v:.12e}" for v in TR[:3].ravel())])


def _write_scan(folder: Path, scan: SimulatedScan) -> None:
    name = f"{scan.number:06d}"
    table = np.concatenate([scan.points, scan.intensity[:, None]], axis=1).astype("<f4")
    (folder / "velodyne" / f"{name}.bin").write_bytes(table.tobytes())
    (folder / "labels" / f"{name}.label").write_bytes(scan.labels.astype("<u4").tobytes())


def _write_lines(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
