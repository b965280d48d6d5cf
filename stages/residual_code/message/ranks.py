"""Values of which there are few different ones that come one after the other, as the times of the columns of a sensor: a record of kind RANKS.

It holds the different values and, in a record of their own, their ranks. So the points of a layer, which tell no rows and columns, still go
on from column to column, and what is missing between them is a step of more than one.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.entropy.integers import encode_column
from salpcc.stages.entropy.number_forms import from_bits, to_bits
from salpcc.stages.residual_code.message.plain_records import decode_plain, encode_plain
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import RANKS, Values, read_small, unpacked

_HEAD = struct.Struct("<qII")  # least value, further ones, bytes of the steps between them
_EACH = 8  # points of a value, at least
_LARGEST = 1 << 46  # step
_RANK = np.dtype(np.int32)


def encode_ranks(values: Values, points: Points) -> bytes | None:
    """A field of few different values, most often each the next one after the one before; None where it is none, or where there are columns."""
    if points.of_rows(values):
        return None
    different, ranks = np.unique(to_bits(values), return_inverse=True)
    steps = np.diff(different)
    if _EACH * len(different) > len(values) or not ((steps > 0) & (steps < _LARGEST)).all():
        return None
    if 2 * np.count_nonzero(np.diff(ranks) == 1) < len(ranks):
        return None
    between = encode_column(steps)
    head = _HEAD.pack(int(different[0]), len(steps), len(between))
    return bytes([RANKS]) + head + between + encode_plain(ranks.astype(_RANK), points, None)


def decode_ranks(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    """Inverse of :func:`encode_ranks`: the values, and where the record ends; ``at``: behind its kind."""
    (least, n_steps, length), at = unpacked(_HEAD, data, at)
    require_sound(_EACH * (n_steps + 1) <= len(points.void), at + length <= len(data))
    steps = read_small(n_steps, data[at : at + length])
    different = np.concatenate([[least], least + np.cumsum(steps)])
    ranks, end = decode_plain(data, at + length, _RANK, points, None)
    require_sound((ranks >= 0).all(), (ranks < len(different)).all())
    return from_bits(different[ranks], kind), end
