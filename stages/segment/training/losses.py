"""Losses: weighted cross-entropy over the 19 classes, and cross-entropy and Lovasz over the three groups.

The groups are what a task acts on, so they are trained for directly. The Lovasz extension (Berman et
al., CVPR 2018) is a smooth stand-in for the IoU, eq. (21).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from salpcc.schemas.labels import GROUP_OF_CLASS, GROUPS, MOVABLE
from salpcc.stages.segment.network import N_CLASSES

_GROUP_OF_OUTPUT = torch.tensor(GROUP_OF_CLASS[1 : N_CLASSES + 1].astype("int64"))


def group_logits(logits: Tensor) -> Tensor:
    """Sum classes up to groups, in the log domain: ``(N, 19)`` to ``(N, 3)``."""
    members = [
        torch.eq(_GROUP_OF_OUTPUT, group).nonzero().ravel().to(logits.device) for group in range(len(GROUPS))
    ]
    return torch.stack([torch.logsumexp(logits[:, member], 1) for member in members], 1)


def lovasz(probabilities: Tensor, targets: Tensor) -> Tensor:
    """Lovasz-softmax of ``(N, G)`` probabilities against ``(N,)`` targets, mean over the groups that occur."""
    losses = []
    for group in range(probabilities.shape[1]):
        truth = (targets == group).float()
        if not truth.any():
            continue
        errors, order = torch.sort((truth - probabilities[:, group]).abs(), descending=True)
        truth = truth[order]
        union = truth.sum() + torch.cumsum(1.0 - truth, 0)
        jaccard = 1.0 - (truth.sum() - torch.cumsum(truth, 0)) / union
        jaccard = torch.cat([jaccard[:1], jaccard[1:] - jaccard[:-1]])
        losses.append(torch.dot(errors, jaccard))
    return torch.stack(losses).mean() if losses else probabilities.sum() * 0.0


def segmentation_loss(logits: Tensor, targets: Tensor, class_weights: Tensor, movable: float = 1.0) -> Tensor:
    """Return the training loss.

    Args:
        logits: ``(B, 19, H, W)``.
        targets: ``(B, H, W)`` int64, -1 where there is no label.
        class_weights: ``(19,)``.
        movable: weight of the group movable, the others weigh 1.
    """
    labelled = targets >= 0
    rows = logits.permute(0, 2, 3, 1)[labelled].float()
    truth = targets[labelled]
    if not len(truth):
        return logits.sum() * 0.0
    by_class = functional.cross_entropy(rows, truth, weight=class_weights.to(rows.device))
    groups = group_logits(rows)
    truth_groups = _GROUP_OF_OUTPUT.to(truth.device)[truth]
    weights = torch.ones(len(GROUPS), device=rows.device)
    weights[MOVABLE] = movable
    by_group = functional.cross_entropy(groups, truth_groups, weight=weights)
    thin = slice(None, None, 2)  # sorting every pixel costs more than it brings
    return by_class + by_group + lovasz(torch.softmax(groups[thin], 1), truth_groups[thin])
