"""Motion between frames: found in a made-up scene, and not claimed where there is none."""

import numpy as np
import pytest

from salpcc.stages.ingest.paper_grid import directions, nearest_of_cells, row_elevations
from salpcc.stages.predict.paper.motion import UNITS, find_motion, rotation

ELEVATION = row_elevations([])


def _street(motion: np.ndarray) -> np.ndarray:
    """Points by cell of a street with side walls and cross walls, seen after ``motion``."""
    rng = np.random.default_rng(0)
    n = 150_000
    ground = np.column_stack([rng.uniform(-40, 40, n), rng.uniform(-9, 9, n), np.full(n, -1.7)])
    side = np.column_stack([rng.uniform(-40, 40, n), 9.0 * rng.choice([-1, 1], n), rng.uniform(-1.7, 3, n)])
    cross = np.column_stack(
        [rng.choice([-31.0, -14.0, 12.0, 33.0], n), rng.uniform(4, 9, n), rng.uniform(-1.7, 3, n)]
    )
    points = np.vstack([ground, side, cross]) @ rotation(motion[3:]).T + motion[:3]
    _, level = nearest_of_cells(points.astype(np.float32), 0.001)
    return directions(ELEVATION) * (level.reshape(-1, 1) * 0.001)


@pytest.mark.parametrize("motion", [(-1.2, 0.02, 0.0, 0.0, 0.001, 0.02), (0.0,) * 6])
def test_finds_the_motion(motion: tuple[float, ...]) -> None:
    wanted = np.array(motion)
    found = find_motion(_street(np.zeros(6)), _street(wanted), 0.9 * wanted)
    assert found is not None
    assert np.abs(found * UNITS - wanted)[:3].max() < 0.04
    assert np.abs(found * UNITS - wanted)[3:].max() < 0.003


def test_nothing_to_see_has_no_motion() -> None:
    empty = np.zeros((64 * 2000, 3))
    assert find_motion(empty, empty) is None
    assert find_motion(_street(np.zeros(6)), empty) is None
