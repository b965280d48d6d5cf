"""Room for what an encoder writes, as nobody knows how much before; what a decoder takes, and whether it made sense."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError

_PER_VALUE, _SPARE = 4, 4096  # bytes that are enough, but for values that nobody expects
_END = 16  # bytes that an encoder may need beyond those that it keeps
ENDLESS = 1 << 60  # more bytes, or bits, than anything takes


def room_for(most: int, to_beat: int) -> NDArray[np.uint8]:
    """Return a buffer for what may take ``most`` bytes, but is of no use if it takes more than ``to_beat``: a walk ends where the buffer does."""
    return np.empty(min(most, to_beat + _END), np.uint8)


def within(out: NDArray[np.uint8], written: int, to_beat: int) -> bytes | None:
    """Return the bytes that were written to a buffer of :func:`room_for`; None where it was too small (-1), or they are more than ``to_beat``."""
    return out[:written].tobytes() if 0 <= written <= to_beat else None


def run_encoder(
    encode: Callable[[NDArray[np.uint8]], int], values: int, *learning: NDArray[np.generic]
) -> bytes:
    """Call an encoder of about ``values`` values with a buffer, with a larger one if it returns -1.

    ``learning``: models that outlive the call and learn from what is encoded; before another call they are set back to
    what a decoder will begin with.

    >>> def encode(out):
    ...     if len(out) < 5000:
    ...         return -1
    ...     out[:5000] = 7
    ...     return 5000
    >>> len(run_encoder(encode, 10))
    5000
    """
    size = _PER_VALUE * values + _SPARE
    first = [model.copy() for model in learning]
    while True:
        out = np.empty(size, np.uint8)
        written = encode(out)
        if written >= 0:
            return out[:written].tobytes()
        size *= 4
        for model, before in zip(learning, first, strict=True):
            model[...] = before


def as_array(stream: bytes) -> NDArray[np.uint8]:
    """Return a stream as the decoders' kernels take it, writable."""
    return np.frombuffer(bytearray(stream), np.uint8)


def require_sound(*facts: object) -> None:
    """Go on only if the decoded values are what they may be.

    Raises:
        ArchiveError: they are not.
    """
    if not all(facts):
        raise ArchiveError("payload does not decode")
