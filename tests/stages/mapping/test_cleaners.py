"""Public cleaners: each keeps a wall and takes out what moved before it."""

from __future__ import annotations

import numpy as np
import pytest

from salpcc.schemas.errors import UsageError
from salpcc.stages.mapping.cleaners import CLEANERS, cleaner


@pytest.mark.parametrize("name", sorted(CLEANERS))
def test_a_wall_stays_and_what_moved_goes(name: str) -> None:
    pytest.importorskip(name)
    y, z = (side.ravel() for side in np.meshgrid(np.arange(-3, 3, 0.04), np.arange(-1.0, 1.0, 0.04)))
    wall = np.column_stack([np.full(len(y), 8.05), y, z])
    scans, moving = [], []
    for k in range(8):
        low = -2.8 + 0.7 * k  # a box, half a metre wide, that hides a part of the wall
        bearing = y / 8.05 * 5.05
        hit = (bearing >= low) & (bearing < low + 0.5)
        points = np.where(hit[:, None], wall * (5.05 / 8.05), wall)
        scans.append((points.astype(np.float32), np.eye(4)))
        moving.append(hit)
    kept = cleaner(name)(scans)
    assert all(mask.shape == (len(points),) for mask, (points, _) in zip(kept, scans, strict=True))
    still = np.concatenate([mask[~hit] for mask, hit in zip(kept, moving, strict=True)])
    gone = np.concatenate([~mask[hit] for mask, hit in zip(kept, moving, strict=True)])
    assert still.mean() > 0.9 and gone.mean() > 0.4


def test_an_unknown_cleaner_is_told() -> None:
    with pytest.raises(UsageError, match="choose from dufomap, octomap"):
        cleaner("removert")
