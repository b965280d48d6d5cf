"""Files beside the points: no checksums, so what reads well is taken; it must be of the shape that it claims."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from payloads import SENSOR
from target import Target, Wrong

from salpcc.schemas.manifest import load_manifest
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.kitti_raw import read_timestamps
from salpcc.stages.ingest.sources.semantickitti import read_classes, read_times
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes, read_points, read_points_with_rings
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.mapping.drive.poses import read_poses

_POINTS = np.random.default_rng(0).normal(0, 20, (50, 4)).astype("<f4")
_POSE = "1 0 0 {x} 0 1 0 0 0 0 1 0\n"
_TR = "P0: 7 0 6 0 0 7 1 0 0 0 1 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n"


def _written(name: str, read: Callable[[Path], object], **others: str) -> Callable[[int, bytes, Path], None]:
    def go(_: int, data: bytes, folder: Path) -> None:
        for other, text in others.items():
            (folder / other.replace("_", ".")).write_text(text)
        (folder / name).write_bytes(data)
        read(folder / name)

    return go


def _bin(path: Path) -> None:
    points, intensity = read_points(path)
    if points_to_bytes(points, intensity) != path.read_bytes():
        raise Wrong("points differ from their file")


def _ringed(path: Path) -> None:
    points, intensity, ring = read_points_with_rings(path)
    if not len(points) == len(intensity) == path.stat().st_size // 20 or (
        ring is not None and ring.max() > 4095
    ):
        raise Wrong("points are not those of their file")


def _label(path: Path) -> None:
    if len(read_classes(ScanRef("0", 0, "0.bin", 0, str(path)), 50)) != 50:
        raise Wrong("not one class per point")


def _poses(path: Path) -> None:
    if read_poses(path).shape[1:] != (4, 4):
        raise Wrong("not poses")


def _sensor(path: Path) -> None:
    model = load_sensor(path)
    if not np.isfinite(model.parameters).all() or len(model.shift) != model.n_lasers:
        raise Wrong("a sensor model that cannot be")


TARGETS = {
    ".pcd.bin": Target(lambda _: [_POINTS[:40].tobytes()], _written("0.pcd.bin", _ringed), 0.04),
    ".bin": Target(lambda _: [_POINTS.tobytes()], _written("0.bin", _bin), 0.04),
    ".label": Target(lambda _: [np.full(50, 40, "<u4").tobytes()], _written("0.label", _label), 0.04),
    "times.txt": Target(
        lambda _: [b"".join(b"%.6e\n" % (0.1 * n) for n in range(20))], _written("times.txt", read_times), 0.03
    ),
    "timestamps.txt": Target(
        lambda _: [b"2011-09-26 13:02:25.951199337\n2011-09-26 13:02:26.054445248\n"],
        _written("timestamps.txt", read_timestamps),
        0.03,
    ),
    "poses.txt": Target(
        lambda _: ["".join(_POSE.format(x=n) for n in range(5)).encode()],
        _written("poses.txt", _poses, calib_txt=_TR),
        0.03,
    ),
    "calib.txt": Target(
        lambda _: [_TR.encode()],
        _written("calib.txt", lambda p: _poses(p.with_name("poses.txt")), poses_txt=_POSE.format(x=1)),
        0.03,
    ),
    "manifest": Target(
        lambda _: [yaml.safe_dump({"version": 1, "sources": {"a": {"description": "b", "root": "x", "sequences": {"00": 5}}}}).encode()],
        _written("manifest.yaml", load_manifest),
        0.03,
    ),
    "sensor model": Target(lambda _: [SENSOR.to_json().encode()], _written("sensor.json", _sensor), 0.04),
}  # fmt: skip
