"""Random windows of clips as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from salpcc.schemas.grid import COLUMNS
from salpcc.stages.predict.paper.st_lstm.dataset import Clip


@dataclass(frozen=True, eq=False)
class Window:
    """Some steps of some clips; all ``(batch, steps, …, 64, columns)``.

    Attributes:
        base: int32 mm; offsets: int16 mm; features: int16 in 1/128; last, target: int32 mm, 0 where empty.
    """

    base: Tensor
    offsets: Tensor
    features: Tensor
    last: Tensor
    target: Tensor


def whole(clip: Clip, first: int = 0, steps: int | None = None, columns: slice = slice(None)) -> Window:
    """Return steps of one clip, a batch of one."""
    last = len(clip.inputs) if steps is None else first + steps
    inputs = clip.inputs[first:last]

    def stack(images: Sequence[NDArray[Any]]) -> Tensor:
        return torch.from_numpy(np.stack([image[..., columns] for image in images]))[None]

    return Window(
        stack([i.base for i in inputs]),
        stack([i.offsets for i in inputs]),
        stack([i.features for i in inputs]),
        stack(clip.frames[first:last]),
        stack(clip.frames[first + 1 : last + 1]),
    )


def draw(clips: Sequence[Clip], rng: np.random.Generator, steps: int, columns: int, batch: int) -> Window:
    """Return ``batch`` random windows of at most ``steps`` steps.

    Clips are drawn by their number of steps. Windows of one batch have the length of the shortest.
    """
    share = np.array([len(clip.inputs) for clip in clips], np.float64)
    chosen = [clips[k] for k in rng.choice(len(clips), batch, p=share / share.sum())]
    steps = min(steps, *(len(clip.inputs) for clip in chosen))
    parts = []
    for clip in chosen:
        first = int(rng.integers(len(clip.inputs) - steps + 1))
        column = 8 * int(rng.integers((COLUMNS - columns) // 8 + 1))
        parts.append(whole(clip, first, steps, slice(column, column + columns)))
    return Window(
        *(
            torch.cat([getattr(p, name) for p in parts])
            for name in ("base", "offsets", "features", "last", "target")
        )
    )
