"""IoU of groups and classes."""

from __future__ import annotations

import numpy as np
import pytest

from salpcc.schemas.labels import CLASSES, GROUND, GROUPS, MOVABLE, OTHER
from salpcc.stages.segment.confusion import (
    class_confusion,
    group_confusion,
    group_counts,
    intersection_over_union,
    mean_iou,
)

CAR, ROAD, BUILDING = (
    next(i for i, c in enumerate(CLASSES) if c.name == n) for n in ("car", "road", "building")
)


def test_iou_by_hand() -> None:
    truth = np.array([CAR, CAR, ROAD, ROAD, ROAD, BUILDING], np.uint8)
    groups = np.array([MOVABLE, OTHER, GROUND, GROUND, OTHER, OTHER], np.uint8)
    scores = intersection_over_union(group_confusion(group_counts(truth, groups)), GROUPS)
    assert scores == {"movable": 1 / 2, "ground": 2 / 3, "other": 1 / 3}
    assert mean_iou(scores) == pytest.approx(0.5)


def test_unlabelled_points_do_not_count() -> None:
    truth = np.array([0, 0, CAR], np.uint8)
    counts = group_confusion(group_counts(truth, np.array([MOVABLE, GROUND, MOVABLE], np.uint8)))
    assert counts.sum() == 1
    assert intersection_over_union(counts, GROUPS) == {"movable": 1.0}


def test_a_class_can_be_left_out_of_the_groups() -> None:
    terrain = next(i for i, c in enumerate(CLASSES) if c.name == "terrain")
    counts = group_counts(np.array([terrain, ROAD], np.uint8), np.array([GROUND, GROUND], np.uint8))
    assert intersection_over_union(group_confusion(counts), GROUPS) == {"ground": 0.5, "other": 0.0}
    assert intersection_over_union(group_confusion(counts, without=("terrain",)), GROUPS) == {"ground": 1.0}


def test_a_segmenter_of_groups_has_no_class_scores() -> None:
    only_ground = np.array([len(CLASSES) - 1], np.uint8)
    assert class_confusion(np.array([ROAD], np.uint8), only_ground) is None
    assert class_confusion(np.array([ROAD], np.uint8), np.array([ROAD], np.uint8)) is not None


def test_classes_that_never_occur_are_left_out_of_the_mean() -> None:
    assert mean_iou({}) is None
    assert mean_iou({"car": 0.5}) == 0.5
