"""What records of fields are made of: their kinds, heads, and small columns."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, require_sound
from salpcc.stages.entropy.integers import decode_column
from salpcc.stages.residual_code.message.points import Points

(
    CONSTANT,
    RESIDUALS,
    SYMBOLS,
    BY_LASER,
    TIMES,
    COLUMNS,
    TIMELINE,
    BLENDED,
    LEARNED,
    MULTIPLES,
    RANKS,
) = range(11)
Values = NDArray[Any]
Integers = NDArray[np.int64]


def read_small(n: int, data: bytes) -> Integers:
    """A small column ``(n,)`` that :func:`~salpcc.stages.entropy.integers.encode_column` wrote.

    Raises:
        ArchiveError: it does not decode.
    """
    values, sound = decode_column(n, as_array(data))
    require_sound(sound)
    return values


def unpacked(what: struct.Struct, data: bytes, at: int) -> tuple[tuple[Any, ...], int]:
    """Return the numbers of a head at ``at``, and where it ends."""
    require_sound(at + what.size <= len(data))
    return what.unpack_from(data, at), at + what.size


def flags_of(points: Points, void: int) -> NDArray[np.bool_]:
    """Mark the points ``(N,)`` that count as void: none with ``void`` 0."""
    return points.void if void else np.zeros(len(points.void), np.bool_)
