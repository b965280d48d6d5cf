"""IoU of groups and classes."""

from __future__ import annotations

import numpy as np
import pytest

from salpcc.schemas.labels import CLASSES, GROUND, GROUPS, MOVABLE, OTHER
from salpcc.stages.evaluate.confusion import (
    class_confusion,
    group_confusion,
    intersection_over_union,
    mean_iou,
    predicted_groups,
)

CAR, ROAD, BUILDING = (
    next(i for i, c in enumerate(CLASSES) if c.name == n) for n in ("car", "road", "building")
)


def test_iou_by_hand() -> None:
    truth = np.array([CAR, CAR, ROAD, ROAD, ROAD, BUILDING], np.uint8)
    groups = np.array([MOVABLE, OTHER, GROUND, GROUND, OTHER, OTHER], np.uint8)
    scores = intersection_over_union(group_confusion(truth, groups), GROUPS)
    assert scores == {"movable": 1 / 2, "ground": 2 / 3, "other": 1 / 3}
    assert mean_iou(scores) == pytest.approx(0.5)


def test_unlabelled_points_do_not_count() -> None:
    truth = np.array([0, 0, CAR], np.uint8)
    counts = group_confusion(truth, np.array([MOVABLE, GROUND, MOVABLE], np.uint8))
    assert counts.sum() == 1
    assert intersection_over_union(counts, GROUPS) == {"movable": 1.0}


def test_dropped_points_were_taken_for_movable() -> None:
    kept = np.array([True, False, True])
    assert predicted_groups(kept, np.array([ROAD, BUILDING], np.uint8)).tolist() == [GROUND, MOVABLE, OTHER]


def test_a_segmenter_of_groups_has_no_class_scores() -> None:
    only_ground = np.array([len(CLASSES) - 1], np.uint8)
    assert class_confusion(np.array([ROAD], np.uint8), only_ground) is None
    assert class_confusion(np.array([ROAD], np.uint8), np.array([ROAD], np.uint8)) is not None


def test_classes_that_never_occur_are_left_out_of_the_mean() -> None:
    assert mean_iou({}) is None
    assert mean_iou({"car": 0.5}) == 0.5
