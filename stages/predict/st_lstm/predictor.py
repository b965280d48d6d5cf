"""One step of the prediction network: decoded frames in, the next frame out, the same on every machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of the next frame.

    Attributes:
        ranges: ``(64, 2000)`` int32, millimetres; 0 where there is no prediction.
        spread: ``(64, 2000)`` uint8, 0 to 15, how far off the prediction is expected to be: a coder's context.
    """

    ranges: Image
    spread: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Memory:
    """What the network carries from one frame of a group of pictures to the next; never changed in place."""

    frames: tuple[Image, ...] = ()


def predict_frame(
    memory: Memory | None,
    last: Image,
    motion: NDArray[np.float64] | None,
    elevation: NDArray[np.float64] | None = None,
) -> tuple[Prediction, Memory]:
    """Predict the frame after ``last``.

    Args:
        memory: what the call for the frame before returned; None after the first frame of a group.
        last: ``(64, 2000)`` int32, decoded ranges in millimetres, 0 where the cell is empty.
        motion: ``(6,)`` float64 ``(v, w)``, metres and radians, that carries points of the last frame into
            the next, ``P' = R(w) P + v``; None where it is not known (the sensor counts as standing).
        elevation: ``(64,)`` float64 radians, the mean elevation of the points of each row where it is
            known (both sides must give the same); by default the centres of the rows.
    """
    return Prediction(last, np.zeros(last.shape, np.uint8)), Memory((last,))
