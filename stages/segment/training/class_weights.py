"""What classes weigh: in the loss, by how rarely they occur; and in what labelling says, put into the last layer of the network."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES

_NAMES = [c.name for c in CLASSES[1:20]]

# Shares of the points of the 19 classes in SemanticKITTI, in the order of CLASSES (its published statistics).
SHARES: NDArray[np.float32] = np.array(
    [
        4.26e-2, 1.7e-4, 4.0e-4, 1.96e-3, 2.3e-3, 3.4e-4, 1.3e-4, 4e-5, 1.99e-1, 1.47e-2,
        1.44e-1, 3.9e-3, 1.33e-1, 7.2e-2, 2.67e-1, 6.0e-3, 7.8e-2, 2.9e-3, 6.2e-4,
    ],
    np.float32,
)  # fmt: skip

_HEAVIEST = np.float32(
    30.0
)  # before the mean is taken out: a dozen bicyclists are no reason to learn them by heart

# Probabilities count so many times, whatever was learned (logit adjustment, Menon et al., ICLR 2021). Crops hold cars by the dozen,
# but a handful of lorries and vans; one that looks like none of these is told apart with too little confidence. Chosen
# on networks that had not seen the scenes (MODEL_CARD.md).
IN_STREETS = {"car": 0.5, "truck": 3.0, "other-vehicle": 3.0}


def training_weights(root: float = 4.0) -> NDArray[np.float32]:
    """Return the weight ``(19,)`` of each class in the loss: root of the inverse share, mean 1 over the points."""
    weights = np.minimum(SHARES ** np.float32(-1.0 / root), _HEAVIEST)
    return weights / (weights * SHARES).sum()


def weigh(state: dict[str, torch.Tensor], counts: Mapping[str, float]) -> dict[str, torch.Tensor]:
    """Return the weights of a network whose probabilities of some classes count so many times as much; the others once."""
    bias = state["head.bias"]
    each = torch.tensor([counts.get(name, 1.0) for name in _NAMES], device=bias.device).log()
    return state | {"head.bias": bias + each.repeat_interleave(len(bias) // len(each)).to(bias.dtype)}


def unweigh(state: dict[str, torch.Tensor], counts: Mapping[str, float]) -> dict[str, torch.Tensor]:
    """Inverse of :func:`weigh`."""
    return weigh(state, {name: 1.0 / count for name, count in counts.items()})
