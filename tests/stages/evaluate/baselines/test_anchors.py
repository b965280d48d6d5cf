"""Rates of the outside codecs against those that others measured on the same three KITTI raw scans, within 2 %."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from salpcc.stages.evaluate.baselines import BASELINES

SCANS = (
    "rtst_5/velodyne_points/data/0000000000.bin",
    "single/example.bin",
    "2011_09_26_drive_0005_sync/velodyne_points/data/0000000000.bin",
)


@pytest.mark.parametrize(
    ("name", "error", "bpp"), [("draco", 0.005, 11.49), ("laszip", 0.01, 6.57), ("tmc13", 0.01, 6.14)]
)
def test_the_rate_is_what_others_found(name: str, error: float, bpp: float, real_data: Path) -> None:
    baseline = BASELINES[name]
    if missing := baseline.missing():
        pytest.skip(missing)
    found = []
    for scan in SCANS:
        points = np.fromfile(real_data / "kitti_raw" / scan, np.float32).reshape(-1, 4)[:, :3].copy()
        found.append(8 * len(baseline.encode(points, error)) / len(points))
    assert np.mean(found) == pytest.approx(bpp, rel=0.02)
