"""One field of all points, coded in the form and by the prediction that cost least.

A record is self-contained: how the field was taken, then its stream. Constant fields take a few bytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.entropy.number_forms import to_bits
from salpcc.stages.residual_code.message.learned_values import LearnedField
from salpcc.stages.residual_code.message.multiples import (
    find_step,
    holds,
    of_step,
    read_step,
    write_multiples,
)
from salpcc.stages.residual_code.message.picture_records import (
    decode_picture,
    encode_picture,
    encode_picture_like,
)
from salpcc.stages.residual_code.message.placed_records import (
    decode_column_record,
    decode_laser_record,
    decode_timeline_record,
    decode_times_record,
    encode_column_record,
    encode_columns_like,
    encode_laser_record,
    encode_timeline_record,
    encode_times_like,
    encode_times_record,
)
from salpcc.stages.residual_code.message.plain_records import decode_plain, encode_plain, encode_plain_like
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.ranks import decode_ranks, encode_ranks
from salpcc.stages.residual_code.message.records import (
    BLENDED,
    BY_LASER,
    COLUMNS,
    CONSTANT,
    LEARNED,
    MULTIPLES,
    RANKS,
    RESIDUALS,
    SYMBOLS,
    TIMELINE,
    TIMES,
    Values,
)

_FEWEST = 500  # values; delays, shifts and the like of fewer cost more than they save
_WORTH_IT = 0.05  # bits a value; fields that take less are left


def encode_field(
    values: Values,
    points: Points,
    base: Values | None = None,
    learned: LearnedField | None = None,
    beside: Values | None = None,
) -> bytes:
    """Encode a field ``(N,)`` of any number type, bit for bit.

    Args:
        base: values of the same type that it is close to, such as the coordinate it was rounded from.
        learned: of this field before, for efforts above ``fast``.
        beside: the field ``(T,)`` of the static layer, where the points are those of the movable one.
    """
    known = _encode_known(values, points)
    if known is not None:
        return known
    coded = encode_plain(values, points, base)
    if base is not None or len(values) < _FEWEST or 8 * len(coded) < _WORTH_IT * len(values):
        return coded
    step = 1 if learned is None else find_step(values)
    if step > 1:
        multiples = encode_field(of_step(values, step), points, None, learned, _multiples(beside, step))
        return min(coded, write_multiples(step, multiples), key=len)
    coded = _shorter(coded, encode_laser_record(values, points))
    coded = _shorter(coded, encode_column_record(values, points, len(coded), beside))
    coded = _shorter(coded, encode_picture(values, points, learned, len(coded), beside))
    coded = _shorter(coded, encode_times_record(values, points, len(coded), beside))
    return coded if len(coded) < len(values) // 8 else _shorter(coded, encode_ranks(values, points))


def _multiples(beside: Values | None, step: int) -> Values | None:
    """The field of the static layer in steps; None where it is not in whole ones."""
    if beside is None or beside.dtype.kind not in "iu" or (beside % beside.dtype.type(step)).any():
        return None
    return of_step(beside, step)


def _shorter(coded: bytes, other: bytes | None) -> bytes:
    """The shorter of two records, the first of two as long."""
    return coded if other is None else min(coded, other, key=len)


def encode_like(
    record: bytes,
    values: Values,
    points: Points,
    base: Values | None = None,
    learned: LearnedField | None = None,
    beside: Values | None = None,
) -> bytes | None:
    """Encode a field as ``record`` of the scan before has it; None where that cannot be.

    Args:
        base, learned, beside: as for :func:`encode_field`.
    """
    known = _encode_known(values, points)
    if known is not None:
        return known
    form = record[0]
    if form == MULTIPLES:
        step = read_step(record, 0, values.dtype)
        if (values % values.dtype.type(step)).any():
            return None
        of = _multiples(beside, step)
        coded = encode_like(record[holds(record) :], of_step(values, step), points, None, learned, of)
        return coded and write_multiples(step, coded)
    if form in (RESIDUALS, SYMBOLS):
        return encode_plain_like(record, values, points, base)
    if form == BY_LASER:
        return encode_laser_record(values, points)
    if form == TIMES:
        return encode_times_like(record, values, points, beside)
    if form == RANKS:
        return encode_ranks(values, points)
    if form == COLUMNS:
        return encode_columns_like(record, values, points, beside)
    if form in (BLENDED, LEARNED):
        return encode_picture_like(record, values, points, learned, beside)
    return None


def _encode_known(values: Values, points: Points) -> bytes | None:
    """A field that costs nothing: of one value, or the times that the points tell; None where it is another."""
    bits = to_bits(values)
    if len(values) == 0 or (bits == bits[0]).all():
        return bytes([CONSTANT]) + values[:1].tobytes().ljust(values.dtype.itemsize, b"\0")
    return encode_timeline_record(values, points)


_DECODE = {
    BY_LASER: decode_laser_record,
    TIMELINE: decode_timeline_record,
    RANKS: decode_ranks,
}


def decode_field(
    data: bytes,
    at: int,
    kind: np.dtype[Any],
    points: Points,
    base: Values | None = None,
    learned: LearnedField | None = None,
    beside: Values | None = None,
) -> tuple[Values, int]:
    """Inverse of :func:`encode_field`: the values, and where the record at ``at`` ends.

    Raises:
        ArchiveError: the record is damaged.
    """
    n = len(points.void)
    require_sound(at + 1 + kind.itemsize <= len(data))
    if data[at] == CONSTANT:
        end = at + 1 + kind.itemsize
        return np.full(n, np.frombuffer(data, kind, 1, at + 1)[0]), end
    if data[at] == MULTIPLES:
        step = read_step(data, at, kind)
        of = _multiples(beside, step)
        values, end = decode_field(data, holds(data, at), kind, points, None, learned, of)
        return values * kind.type(step), end
    if data[at] == TIMES:
        return decode_times_record(data, at + 1, kind, points, beside)
    if data[at] == COLUMNS:
        return decode_column_record(data, at + 1, kind, points, beside)
    if data[at] == BLENDED or (data[at] == LEARNED and learned is not None):
        return decode_picture(data, at + 1, kind, points, learned if data[at] == LEARNED else None, beside)
    if data[at] in _DECODE:
        return _DECODE[data[at]](data, at + 1, kind, points)
    return decode_plain(data, at, kind, points, base)
