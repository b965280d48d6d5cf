"""How the networks of an effort are trained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

Rows = dict[str, NDArray[Any]]  # inputs and what they should give, a row a return


@dataclass(frozen=True)
class Recipe:
    """How one effort level is trained.

    Attributes:
        range_width, intensity_width: units of each hidden layer; multiples of 8.
        range_layers: hidden layers of the range network; intensity has two.
        optimiser_steps, batch: of AdamW with a one-cycle learning rate up to ``rate``; intensity has its own:
            at 0.01 a long run learned nothing after 2,500 steps.
        share: part of the returns used at step 1; ``coarse_share`` at each coarser step.
        looks_back: whether the networks see the sweep before.
        seed: of the weights, the choice of returns and the batches.
    """

    range_width: int = 64
    range_layers: int = 2
    intensity_width: int = 64
    optimiser_steps: int = 12000
    intensity_steps: int = 6000
    batch: int = 8192
    intensity_batch: int = 4096
    rate: float = 1e-2
    intensity_rate: float = 5e-3
    share: float = 0.25
    coarse_share: float = 0.08
    looks_back: bool = False
    seed: int = 0


RECIPES = {
    "default": Recipe(),
    "max": Recipe(128, 3, 96, optimiser_steps=6000, looks_back=True),
}
