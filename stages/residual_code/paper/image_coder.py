"""What codes the mask, the ground map and the levels of range images: the contract, and what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Images:
    """What both sides know before a frame.

    Attributes:
        plane, frame: levels ``(64, 2000)`` of its planes and from the frames before, 0 for none.
        spread: ``(64, 2000)`` uint8, how far off ``frame`` is expected to be, 0 to 15.
        elevation: ``(64,)`` int16 of the rows, thousandths of a degree.
        accuracy: metres per level.
    """

    plane: NDArray[np.int32]
    frame: NDArray[np.int32]
    spread: NDArray[np.uint8]
    elevation: NDArray[np.int16]
    accuracy: float


class ImageCoder(Protocol):
    """Codes the frames of a GOP, one after the other."""

    def encode(
        self, level: NDArray[np.int32], ground: NDArray[np.bool_], images: Images
    ) -> tuple[bytes, bytes, bytes]:
        """Return mask, ground map and levels of a frame as bytes."""
        ...

    def decode(
        self, mask: bytes, ground: bytes, levels: bytes, returns: int, images: Images
    ) -> NDArray[np.int32]:
        """Return the level image; inverse of :meth:`encode`.

        Raises:
            ArchiveError: the streams do not decode to ``returns`` levels.
        """
        ...
