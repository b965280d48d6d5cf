"""Whole numbers that are all multiples of a step, as of sensors that send fewer bits than their fields have: a record of kind MULTIPLES holds that of the multiples."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.residual_code.message.records import MULTIPLES, Values, unpacked

_STEP = struct.Struct("<Q")
_INNER = 1 + _STEP.size  # where the record of the multiples begins
_FIRST = 4096  # values that most fields show it by


def find_step(values: Values) -> int:
    """Return the largest step whose multiples the values ``(N,)`` are; 1 for those that are no whole numbers."""
    if values.dtype.kind not in "iu" or len(values) == 0:
        return 1
    for part in (values[:_FIRST], values):
        step = int(np.gcd.reduce(part))
        if step == 1:
            break
    return max(step, 1)  # 0: they are all 0


def of_step(values: Values, step: int) -> Values:
    """Return which multiples of the step values are."""
    return values // values.dtype.type(step)


def holds(record: bytes, at: int = 0) -> int:
    """Return where the record at ``at`` has that of its multiples; ``at`` if it is of another kind."""
    return at + _INNER if record[at : at + 1] == bytes([MULTIPLES]) else at


def write_multiples(step: int, record: bytes) -> bytes:
    """Return the record of a field whose multiples of a step have this one."""
    return bytes([MULTIPLES]) + _STEP.pack(step) + record


def read_step(data: bytes, at: int, kind: np.dtype[Any]) -> int:
    """Return the step of the record of kind MULTIPLES at ``at``, which none of its own kind must follow.

    Raises:
        ArchiveError: there is none for values of this type.
    """
    ((step,), at) = unpacked(_STEP, data, at + 1)
    require_sound(
        kind.kind in "iu" and 1 < step <= np.iinfo(kind).max and data[at : at + 1] != bytes([MULTIPLES])
    )
    return int(step)
