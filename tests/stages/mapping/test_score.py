"""Scores: by hand on a map of a few voxels."""

from __future__ import annotations

import numpy as np
import pytest

from salpcc.stages.mapping.score import (
    MOVABLE_STILL,
    MOVING,
    STATIC,
    UNKNOWN,
    Tally,
    Truth,
    quality,
    tally,
    truth_of_labels,
)
from salpcc.stages.mapping.voxel import keys_of


def test_labels_tell_what_moves() -> None:
    labels = np.array([0, 1, 40, 70, 10, 30, 252, 259, 52, 99, 252 | (7 << 16)], np.uint32)
    assert truth_of_labels(labels).tolist() == [
        UNKNOWN, UNKNOWN, STATIC, STATIC, MOVABLE_STILL, MOVABLE_STILL, MOVING, MOVING, UNKNOWN, UNKNOWN, MOVING,
    ]  # fmt: skip


def test_labels_made_of_boxes_call_static_what_lies_in_none() -> None:
    """Nothing of such a scan has a class of its own; one that names its ground leaves other-object unknown."""
    boxes = np.array([0, 99, 10, 253, 0], np.uint32)
    assert truth_of_labels(boxes).tolist() == [UNKNOWN, STATIC, MOVABLE_STILL, MOVING, UNKNOWN]
    classes = np.array([40, 99, 10], np.uint32)
    assert truth_of_labels(classes).tolist() == [STATIC, UNKNOWN, MOVABLE_STILL]


def test_scores_by_hand() -> None:
    # Voxels of 0.1 m a metre apart: 4 static points in 2 voxels, 3 moving in 1, 2 standing in 1, and an unlabelled one.
    xyz = np.array([[x + 0.05, 0.05, 0.05] for x in (0, 0, 0, 1, 2, 2, 2, 3, 3, 4)])
    kinds = np.array([STATIC] * 4 + [MOVING] * 3 + [MOVABLE_STILL] * 2 + [UNKNOWN], np.uint8)
    truth = Truth.of_points(xyz, kinds, 0.1)
    in_map = keys_of(np.array([[0.05, 0.05, 0.05], [3.05, 0.05, 0.05]]), 0.1)
    found = quality(tally(truth, in_map, 0.1))
    assert found["moving"] == {
        "SA": 0.75, "DA": 1.0, "AA": pytest.approx(0.75**0.5), "PR": 0.5, "RR": 1.0, "F1": pytest.approx(2 / 3),
    }  # fmt: skip
    assert found["movable"]["DA"] == 0.6
    assert found["movable"]["RR"] == 0.5
    none = quality(tally(truth, truth.keys, 0.1))["moving"]
    assert (none["SA"], none["DA"], none["F1"]) == (1.0, 0.0, 0.0)


def test_counts_add_up_over_parts() -> None:
    rng = np.random.default_rng(0)
    xyz, kinds = rng.uniform(0, 3, (600, 3)), rng.integers(0, 4, 600).astype(np.uint8)
    whole = Truth.of_points(xyz, kinds, 0.1)
    parts = Truth.together([Truth.of_points(xyz[i::3], kinds[i::3], 0.1) for i in range(3)])
    assert np.array_equal(whole.keys, parts.keys) and np.array_equal(whole.points, parts.points)
    keys = whole.keys[::2]
    left = xyz[:, 0] < 1.0  # a border of voxels of 0.2 m, so that none is in both
    halves = [tally(Truth.of_points(xyz[m], kinds[m], 0.1), keys, 0.1) for m in (left, ~left)]
    assert halves[0] + halves[1] == tally(whole, keys, 0.1)


def test_nothing_to_count_is_none() -> None:
    assert set(quality(Tally())["moving"].values()) == {None}
