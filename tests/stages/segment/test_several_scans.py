"""Several scans: neighbours settle what one scan doubts, and free space tells what moves."""

import numpy as np

from salpcc.schemas.labels import MOVABLE, OTHER
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.registration import as_pose
from salpcc.stages.segment.segmenter import Segmentation
from salpcc.stages.segment.several_scans import agree, pose_between

AHEAD = as_pose(np.array([-1.0, 0.02, 0.0, 0.0, 0.0, -0.01]))


def _seen(points: np.ndarray, movable: float) -> Segmentation:
    image = project(points.astype(np.float32), np.full(len(points), 0.3, np.float32))
    groups = np.zeros((3, *image.index.shape), np.float32)
    groups[OTHER] = (1 - movable) * (image.index >= 0)
    groups[MOVABLE] = movable * (image.index >= 0)
    best = np.array([13, 9, 1], np.uint8)[:, None, None] * np.ones_like(groups, np.uint8)
    return Segmentation(image, groups, best)


def _wall(x: float, half: float = 8.0) -> np.ndarray:
    y, z = np.meshgrid(np.arange(-half, half, 0.04), np.arange(-1.6, 0.6, 0.04))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], 1)


def test_steps_chain_and_turn_back() -> None:
    steps = [None, AHEAD, AHEAD]
    there, back = pose_between(steps, 0, 2), pose_between(steps, 2, 0)
    assert np.allclose(there @ back, np.eye(4)) and np.allclose(pose_between(steps, 1, 1), np.eye(4))
    assert np.allclose(there, steps[2] @ steps[1]) and abs(there[0, 3] + 2.0) < 0.01
    assert pose_between([None, None, AHEAD], 0, 2) is None


def test_neighbours_outvote_a_doubt() -> None:
    steps = [None, AHEAD, AHEAD]
    walls = [_wall(20.0)]
    for step in steps[1:]:
        walls.append(walls[-1] @ step[:3, :3].T + step[:3, 3])
    found = [_seen(wall, movable) for wall, movable in zip(walls, (0.1, 0.55, 0.1), strict=True)]
    settled = agree(found, steps)[1]
    pixels = found[1].image.index >= 0
    assert (found[1].classes()[pixels] == 1).all()
    assert (settled.classes()[pixels] == 13).mean() > 0.9
    alone = agree(found, [None, None, None])[1]
    assert (alone.groups == found[1].groups).all()


def test_what_neighbours_looked_through_has_moved() -> None:
    far = _wall(30.0, 12.0)
    box = _wall(15.0, 1.0)
    still = np.eye(4)
    found = [_seen(far, 0.0), _seen(np.concatenate([box, far]), 0.4), _seen(far, 0.0), _seen(far, 0.0)]
    settled = agree(found, [None, still, still, still])[1]
    image = found[1].image
    ours = image.index[(image.index >= 0)] < len(box)
    gained = (settled.groups[MOVABLE] - found[1].groups[MOVABLE])[image.index >= 0]
    assert (gained[ours] > 0.2).mean() > 0.5
    assert (gained[~ours] <= 0.0).mean() > 0.98
