"""Scans and payload rows for the tests of this folder: small, seeded, KITTI-like."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pytest

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan

ROAD, BUILDING, CAR = 9, 13, 1


@pytest.fixture
def street() -> Callable[..., Scan]:
    """``street(name, points, seed)``: a road, two walls and a car, coordinates in whole millimetres."""

    def make(name: str = "000000", points: int = 3000, seed: int = 0) -> Scan:
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-40, 40, points), rng.uniform(-6, 6, points)
        z = np.full(points, -1.7) + rng.normal(0, 0.01, points)
        classes = np.full(points, ROAD, np.uint8)
        wall = rng.random(points) < 0.4
        y[wall], z[wall], classes[wall] = np.sign(y[wall]) * 6, rng.uniform(-1.7, 3, wall.sum()), BUILDING
        car = ~wall & (np.abs(x - 8) < 2) & (np.abs(y) < 2)
        z[car], classes[car] = rng.uniform(-1.7, 0, car.sum()), CAR
        cloud = np.round(np.stack([x, y, z], axis=1), 3).astype(np.float32)
        intensity = (rng.integers(0, 100, points) / 100).astype(np.float32)
        return Scan(name, cloud, intensity, classes=classes)

    return make


@pytest.fixture
def without_movable() -> Callable[[Scan], Scan]:
    """What the task keeps of a scan."""

    def keep(scan: Scan) -> Scan:
        assert scan.classes is not None
        kept = GROUP_OF_CLASS[scan.classes] != MOVABLE
        return Scan(scan.name, scan.points[kept], scan.intensity[kept], classes=scan.classes[kept])

    return keep


@pytest.fixture
def payload_rows() -> Callable[[list[Scan], list[Scan]], pa.Table]:
    """PAYLOAD rows with round sizes: 1000, 600, 50 and 20 bytes a scan."""

    def rows(sources: list[Scan], decoded: list[Scan]) -> pa.Table:
        sizes = {"off_lattice": 1, "geometry": 1000, "intensity": 600, "classes": 50, "side": 20}
        pairs = zip(sources, decoded, strict=True)
        counts = [{"name": a.name, "n_points": len(a), "kept": len(b)} for a, b in pairs]
        dropped = [{"dropped_movable": row["n_points"] - row["kept"]} for row in counts]
        return pa.Table.from_pylist([a | b | sizes for a, b in zip(counts, dropped, strict=True)])

    return rows
