"""One step of the prediction network: decoded frames in, the next frame out, the same on every machine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from salpcc.stages.predict.paper.st_lstm.arithmetic import Exact
from salpcc.stages.predict.paper.st_lstm.checkpoint import SHIPPED, digest, load
from salpcc.stages.predict.paper.st_lstm.inputs import error_of, gather
from salpcc.stages.predict.paper.st_lstm.network import Shape, State, first_state, step
from salpcc.stages.predict.paper.st_lstm.warp import F64, Image, after, pose_of, warp

SPREADS = 16


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of the next frame.

    Attributes:
        ranges: ``(64, 2000)`` int32, millimetres; 0 where there is no prediction.
        spread: ``(64, 2000)`` uint8, 0 to 15, how far off the prediction is expected to be: about
            ``2 ** (0.8 spread)`` mm.
    """

    ranges: Image
    spread: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Memory:
    """What the network carries from one frame of a group of pictures to the next; never changed in place.

    Attributes:
        state: of the network.
        last: the frame that it saw.
        pose: ``(3, 4)`` float64, carries ``last`` into the frame that was predicted.
        predicted: ``(64, 2000)`` int32 mm, what it said of that frame.
    """

    state: State
    last: Image
    pose: F64
    predicted: Image


@dataclass(frozen=True, eq=False)
class Model:
    """The network as it runs: its arithmetic, its sizes, and the SHA-256 of its weights."""

    numbers: Exact
    shape: Shape
    digest: bytes


@cache
def load_model(path: Path = SHIPPED, device: str = "cpu") -> Model:
    """Load weights (once a process); raises SalpccError where they cannot be read or are not exact."""
    layers, shape = load(path)
    return Model(Exact(layers, device), shape, digest(layers))


def predict_frame(
    memory: Memory | None,
    last: Image,
    motion: NDArray[np.float64] | None,
    elevation: NDArray[np.float64] | None = None,
    model: Model | None = None,
) -> tuple[Prediction, Memory]:
    """Predict the frame after ``last``.

    Args:
        memory: what the call for the frame before returned; None after the first frame of a group.
        last: ``(64, 2000)`` int32, decoded ranges in millimetres, 0 where the cell is empty.
        motion: ``(6,)`` float64 ``(v, w)``, metres and radians, that carries points of the last frame into
            the next, ``P' = R(w) P + v``; None where it is not known (the sensor counts as standing).
        elevation: ``(64,)`` float64 radians, the mean elevation of the points of each row where it is
            known (both sides must give the same); by default the centres of the rows.
        model: by default the shipped one.
    """
    model = model or load_model()
    pose = pose_of(np.zeros(6) if motion is None else np.asarray(motion, np.float64))
    base, status = warp(last, pose, elevation)
    before = error = np.zeros_like(last)
    if memory is not None:
        before = warp(memory.last, after(pose, memory.pose), elevation)[0]
        error = error_of(last, memory.predicted)
    inputs = gather(base, status, last, before, error)
    with torch.inference_mode():
        features = torch.from_numpy(inputs.features).to(model.numbers.device).float()[None]
        state = first_state(model.shape, features) if memory is None else memory.state
        shares, spread, state = step(model.numbers, model.shape, features, state)
        # Shares are multiples of 2**-16, so in float64 every product and sum is exact.
        offsets = torch.from_numpy(inputs.offsets).to(model.numbers.device).double()
        off = torch.floor((shares[0].double() * offsets).sum(0) + 0.5).to(torch.int32).cpu().numpy()
        level = torch.floor(spread[0] * 1.25).clamp(0, SPREADS - 1).to(torch.uint8).cpu().numpy()
    ranges = np.where(base > 0, np.maximum(base + off, 1), 0).astype(np.int32)
    return Prediction(ranges, level), Memory(state, last, pose, ranges)
