"""Losses: weighted cross-entropy over the 19 classes, and cross-entropy and Lovasz over the three groups; and what teachers say.

The groups are what a task acts on, so they are trained for directly. The Lovasz extension (Berman et
al., CVPR 2018) is a smooth stand-in for the IoU, eq. (21).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from salpcc.schemas.labels import GROUP_OF_CLASS, GROUPS, MOVABLE
from salpcc.stages.segment.network.multimodal import N_CLASSES
from salpcc.stages.segment.training.labelled import NOT_MOVABLE

_MOVABLE_MORE = 3.0
_NOT = len(GROUPS)  # of a group that is not movable, whichever
_GROUP_OF_TARGET = torch.full((NOT_MOVABLE,), _NOT)
_GROUP_OF_TARGET[:N_CLASSES] = torch.tensor(GROUP_OF_CLASS[1 : N_CLASSES + 1].astype("int64"))

_MEMBERS = [
    torch.eq(_GROUP_OF_TARGET[:N_CLASSES], group).nonzero().ravel().tolist() for group in range(len(GROUPS))
]


def group_logits(logits: Tensor) -> Tensor:
    """Sum classes up to groups, in the log domain: ``(N, 19)`` to ``(N, 3)``."""
    return torch.stack([torch.logsumexp(logits[:, members], 1) for members in _MEMBERS], 1)


def lovasz(probabilities: Tensor, targets: Tensor) -> Tensor:
    """Lovasz-softmax of ``(N, 3)`` probabilities against ``(N,)`` groups, mean over the groups that occur.

    A target of 3 is known not to be movable; the other groups do not count it.
    """
    losses = []
    for group in range(probabilities.shape[1]):
        known = slice(None) if group == MOVABLE else targets != _NOT
        truth = (targets[known] == group).float()
        if not truth.any():
            continue
        errors, order = torch.sort((truth - probabilities[known, group]).abs(), descending=True)
        truth = truth[order]
        union = truth.sum() + torch.cumsum(1.0 - truth, 0)
        jaccard = 1.0 - (truth.sum() - torch.cumsum(truth, 0)) / union
        jaccard = torch.cat([jaccard[:1], jaccard[1:] - jaccard[:-1]])
        losses.append(torch.dot(errors, jaccard))
    return torch.stack(losses).mean() if losses else probabilities.sum() * 0.0


def rows_of(logits: Tensor) -> Tensor:
    """Return logits ``(B, 19, H, W)`` as float32 ``(B H W, 19)``."""
    return logits.permute(0, 2, 3, 1).reshape(-1, logits.shape[1]).float()


def teachers_loss(logits: Tensor, said: Tensor, seen: Tensor) -> Tensor:
    """Return how far a network is from what its teachers say (Hinton et al., 2015): Kullback-Leibler divergence of classes and of groups.

    Args:
        logits: ``(B, 19, H, W)``.
        said: ``(B H W, 19)``, the teachers' probabilities; pixels that they call movable weigh four times as much.
        seen: ``(B, H, W)``, pixels with a return.
    """
    rows, said = rows_of(logits)[seen.ravel()], said[seen.ravel()]
    groups = torch.stack([said[:, members].sum(1) for members in _MEMBERS], 1)
    apart = _divergence(torch.log_softmax(rows, 1), said)
    apart = apart + _divergence(torch.log_softmax(group_logits(rows), 1), groups)
    weights = 1.0 + _MOVABLE_MORE * groups[:, MOVABLE]
    return (apart * weights).sum() / weights.sum().clamp(min=1.0)


def _divergence(logarithms: Tensor, said: Tensor) -> Tensor:
    return (said * (torch.log(said.clamp(min=1e-8)) - logarithms)).sum(1)


def segmentation_loss(logits: Tensor, targets: Tensor, class_weights: Tensor, movable: float = 1.0) -> Tensor:
    """Return the training loss.

    Of a point whose class is not known, only that it is not movable, the loss is minus the logarithm of the summed
    probability of all classes that are not.

    Args:
        logits: ``(B, 19, H, W)``.
        targets: ``(B, H, W)`` int64, -1 where there is no label, NOT_MOVABLE - 1 where no more is known.
        class_weights: ``(19,)``.
        movable: weight of the group movable, the others weigh 1.
    """
    labelled = targets >= 0
    rows = logits.permute(0, 2, 3, 1)[labelled].float()
    truth = targets[labelled]
    if not len(truth):
        return logits.sum() * 0.0
    named = truth < N_CLASSES
    by_class = rows.sum() * 0.0
    if named.any():
        by_class = functional.cross_entropy(rows[named], truth[named], weight=class_weights.to(rows.device))
    groups = torch.log_softmax(group_logits(rows), 1)
    others = [group for group in range(len(GROUPS)) if group != MOVABLE]
    said = torch.cat([groups, torch.logsumexp(groups[:, others], 1, keepdim=True)], 1)
    truth_groups = _GROUP_OF_TARGET.to(truth.device)[truth]
    weights = torch.ones(len(GROUPS) + 1, device=rows.device)
    weights[MOVABLE] = movable
    by_group = functional.nll_loss(said, truth_groups, weight=weights)
    thin = slice(None, None, 2)  # sorting every pixel costs more than it brings
    return by_class + by_group + lovasz(torch.exp(groups[thin]), truth_groups[thin])
