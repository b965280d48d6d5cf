"""Losses against what they stand for."""

import numpy as np
import torch

from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS
from salpcc.stages.segment.training.class_weights import training_weights
from salpcc.stages.segment.training.losses import group_logits, lovasz, segmentation_loss
from salpcc.stages.segment.training.score import scores

WEIGHTS = torch.from_numpy(training_weights())
TARGETS = torch.tensor([0, 0, 1, 2, 2, 2])


def test_lovasz_at_the_corners_is_one_minus_iou() -> None:
    right = torch.nn.functional.one_hot(TARGETS, 3).float()
    assert lovasz(right, TARGETS) < 1e-6
    wrong = right.clone()
    wrong[0] = torch.tensor([0.0, 1.0, 0.0])  # IoU: 1/2 of the first, 1/2 of the second, 1 of the third
    assert abs(lovasz(wrong, TARGETS).item() - (0.5 + 0.5 + 0.0) / 3) < 1e-6


def test_groups_sum_their_classes() -> None:
    logits = torch.randn(7, 19)
    summed = torch.softmax(group_logits(logits), 1)
    single = torch.softmax(logits, 1)
    for group in range(3):
        members = torch.tensor(GROUP_OF_CLASS[1:20] == group)
        assert torch.allclose(summed[:, group], single[:, members].sum(1), atol=1e-6)


def test_unlabelled_pixels_teach_nothing() -> None:
    logits = torch.randn(1, 19, 4, 8, requires_grad=True)
    targets = torch.randint(0, 19, (1, 4, 8))
    targets[0, :2] = -1
    segmentation_loss(logits, targets, WEIGHTS).backward()
    assert not logits.grad[:, :, :2].any() and logits.grad[:, :, 2:].any()
    nothing = segmentation_loss(logits, torch.full_like(targets, -1), WEIGHTS)
    assert nothing.item() == 0.0


def test_scores_by_hand() -> None:
    index = {c.name: i for i, c in enumerate(CLASSES)}
    counts = np.zeros((21, 21), np.int64)
    counts[index["car"], index["car"]] = 8
    counts[index["car"], index["building"]] = 2
    counts[index["road"], index["sidewalk"]] = 10
    counts[index["terrain"], index["road"]] = 10
    counts[index["building"], index["building"]] = 10
    found = scores(counts)
    assert found["movable"] == 0.8 and found["recall_movable"] == 0.8
    assert found["ground"] == 1.0 and found["ground_with_terrain"] == 0.5
    assert found["other"] == 10 / 12 and abs(found["other_with_terrain"] - 10 / 22) < 1e-12


def test_rare_classes_are_weighed_up() -> None:
    assert WEIGHTS[5] > WEIGHTS[0] > WEIGHTS[8]  # person, car, road
