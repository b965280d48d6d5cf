"""The paper's prediction network (section V-B): causal LSTM layers with a gradient highway between them.

A frame enters as patches of 4 x 8 cells (space to depth). Each layer has a temporal memory of its own; the
spatial memory runs through the layers of one step and on from the last layer to the first of the next step
(Wang et al., PredRNN++, 2018). At the cells' own resolution a small head then says which part of the
offsets (:mod:`.inputs`) to add to the warped last frame: the network learns the residual of the warp, and
millimetres need not pass through activations of eight bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from salpcc.stages.predict.paper.st_lstm.arithmetic import Arithmetic
from salpcc.stages.predict.paper.st_lstm.inputs import N_FEATURES, N_OFFSETS

PATCH = (4, 8)
_CELLS = PATCH[0] * PATCH[1]


@dataclass(frozen=True)
class Shape:
    """Sizes: channels of each layer, layers, channels handed up to the head, channels of the head."""

    width: int = 32
    depth: int = 3
    handed: int = 8
    head: int = 24

    def layers(self) -> dict[str, tuple[int, int, int]]:
        """Return outputs, inputs and kernel of every convolution by name."""
        w = self.width
        found = {"enter": (w, N_FEATURES * _CELLS, 1)}
        for number in range(self.depth):
            found[f"temporal{number}"] = (3 * w, 3 * w, 3)
            found[f"spatial{number}"] = (3 * w, 3 * w, 3)
            found[f"memory{number}"] = (w, w, 1)
            found[f"gate{number}"] = (w, 3 * w, 3)
            found[f"join{number}"] = (w, 2 * w, 1)
        found["highway"] = (2 * w, 2 * w, 3)
        found["leave"] = (self.handed * _CELLS, 2 * w, 1)
        found["mix"] = (self.head, self.handed + N_FEATURES, 3)
        found["head"] = (2 * N_OFFSETS + 1, self.head, 1)
        return found


@dataclass(frozen=True, eq=False)
class State:
    """Recurrent state, ``(batch, width, 16, columns / 8)`` each: output D and temporal memory T of every
    layer, spatial memory S, highway H."""

    outputs: tuple[Tensor, ...]
    temporal: tuple[Tensor, ...]
    spatial: Tensor
    highway: Tensor


def first_state(shape: Shape, features: Tensor) -> State:
    """Return the state before the first step: zeros."""
    batch, _, rows, columns = features.shape
    zero = features.new_zeros((batch, shape.width, rows // PATCH[0], columns // PATCH[1]))
    return State((zero,) * shape.depth, (zero,) * shape.depth, zero, zero)


def to_patches(x: Tensor) -> Tensor:
    """Space to depth: ``(batch, channels, 64, columns)`` to ``(batch, 32 channels, 16, columns / 8)``."""
    b, c, rows, columns = x.shape
    x = x.reshape(b, c, rows // PATCH[0], PATCH[0], columns // PATCH[1], PATCH[1])
    return x.permute(0, 1, 3, 5, 2, 4).reshape(b, c * _CELLS, rows // PATCH[0], columns // PATCH[1])


def from_patches(x: Tensor) -> Tensor:
    """Depth to space; inverse of :func:`to_patches`."""
    b, c, rows, columns = x.shape
    x = x.reshape(b, c // _CELLS, PATCH[0], PATCH[1], rows, columns)
    return x.permute(0, 1, 4, 2, 5, 3).reshape(b, c // _CELLS, rows * PATCH[0], columns * PATCH[1])


def cell(
    numbers: Arithmetic, number: int, below: Tensor, output: Tensor, temporal: Tensor, spatial: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """One causal LSTM layer, eqs. (12) to (14).

    Returns output D, temporal memory T, spatial memory S.
    """
    o, i, f = numbers.convolve(f"temporal{number}", below, output, temporal).chunk(3, 1)
    temporal = numbers.blend(numbers.sigmoid(f), temporal, numbers.sigmoid(i), numbers.tanh(o))  # (13)
    o, i, f = numbers.convolve(f"spatial{number}", below, temporal, spatial).chunk(3, 1)
    kept = numbers.tanh(numbers.convolve(f"memory{number}", spatial))
    spatial = numbers.blend(numbers.sigmoid(f), kept, numbers.sigmoid(i), numbers.tanh(o))  # (12)
    gate = numbers.tanh(numbers.convolve(f"gate{number}", below, temporal, spatial))
    joined = numbers.tanh(numbers.convolve(f"join{number}", temporal, spatial))
    return numbers.product(gate, joined), temporal, spatial  # (14)


def highway(numbers: Arithmetic, below: Tensor, before: Tensor) -> Tensor:
    """Gradient highway unit, eqs. (15) to (17)."""
    q, p = numbers.convolve("highway", below, before).chunk(2, 1)
    switch = numbers.sigmoid(q)
    return numbers.blend(numbers.tanh(p), switch, numbers.rest(switch), before)


def step(numbers: Arithmetic, shape: Shape, features: Tensor, state: State) -> tuple[Tensor, Tensor, State]:
    """One step.

    Args:
        features: ``(batch, N_FEATURES, 64, columns)`` activations.

    Returns:
        shares ``(batch, N_OFFSETS, 64, columns)`` of the offsets, within +-1; spread ``(batch, 64,
        columns)``, log2 of the error expected, in mm; the state after.
    """
    entered = numbers.tanh(numbers.convolve("enter", to_patches(features)))
    below, spatial, high = entered, state.spatial, state.highway
    outputs, temporal = [], []
    for number in range(shape.depth):
        below, memory, spatial = cell(
            numbers, number, below, state.outputs[number], state.temporal[number], spatial
        )
        outputs.append(below)
        temporal.append(memory)
        if number == 0:
            high = highway(numbers, below, high)
            below = high
    handed = numbers.relu(numbers.convolve("leave", below, entered))
    mixed = numbers.relu(numbers.convolve("mix", from_patches(handed), features))
    out = numbers.output(numbers.convolve("head", mixed))
    # A share and a gate: an offset of metres that is of no use must be shut off altogether.
    shares = out[:, :N_OFFSETS].clamp(-1.0, 1.0) * out[:, N_OFFSETS:-1].clamp(0.0, 1.0)
    return shares, 4.0 * out[:, -1], State(tuple(outputs), tuple(temporal), spatial, high)


def mixed_ranges(base: Tensor, offsets: Tensor, shares: Tensor) -> Tensor:
    """Return predicted ranges ``(batch, 64, columns)``, mm, unrounded; ``base`` 0 stays 0."""
    return torch.where(base > 0, base + (shares * offsets).sum(1), functional.relu(base))
