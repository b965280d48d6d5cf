"""A field as integers that are told from those before them: records of kinds RESIDUALS and SYMBOLS."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from salpcc.stages.entropy.buffer import ENDLESS, require_sound
from salpcc.stages.entropy.columns import PREDICTORS, costs, decode_residuals, encode_residuals
from salpcc.stages.entropy.number_forms import (
    BITS,
    DECIMAL,
    ORDERED,
    SCALES,
    find_scale,
    from_bits,
    from_scale,
    order,
    to_bits,
    to_scale,
)
from salpcc.stages.entropy.symbols import decode_symbols, encode_symbols
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import RESIDUALS, SYMBOLS, Integers, Values, flags_of

_RECORD = struct.Struct("<BBBBBII")  # form, scale, based, void, predictor, period, length
_SAMPLE = 1 << 16
_Way = tuple[int, int, int, int, int, int]  # form, scale, based, void, predictor, period


def encode_plain(values: Values, points: Points, base: Values | None) -> bytes:
    """Encode a field by the form and the prediction that cost least."""
    width = 8 * values.dtype.itemsize
    best: tuple[int, _Way, Integers] | None = None
    for form, scale, based, integers in _forms(values, points, base):
        bits_of = 64 if form == DECIMAL else width
        wrapped = _wrap(integers, bits_of)
        for void in (0, 1) if points.void.any() else (0,):
            flags = flags_of(points, void)[:_SAMPLE]
            for period in points.periods:
                least = ENDLESS if best is None else best[0]
                found = costs(wrapped[:_SAMPLE], flags, period, bits_of, least)
                for predictor in range(PREDICTORS):
                    if best is None or found[predictor] < best[0]:
                        way = (form, scale, based, void, predictor, period)
                        best = int(found[predictor]), way, wrapped
    assert best is not None
    _, way, integers = best
    coded = _as_residuals(integers, points, way, width)
    for period in points.periods:
        other = _as_symbols(integers, points, (*way[:5], period), width, len(coded))
        coded = coded if other is None else min(coded, other, key=len)
    return coded


def encode_plain_like(record: bytes, values: Values, points: Points, base: Values | None) -> bytes | None:
    """The same as ``record`` has it; None where that cannot be."""
    form, way = record[0], _RECORD.unpack_from(record, 1)[:6]
    width = 8 * values.dtype.itemsize
    for *taken, integers in _forms(values, points, base):
        if tuple(taken) == way[:3] and way[5] in points.periods:
            wrapped = _wrap(integers, 64 if way[0] == DECIMAL else width)
            return (_as_residuals if form == RESIDUALS else _as_symbols)(wrapped, points, way, width)
    return None


def _as_residuals(integers: Integers, points: Points, way: _Way, width: int) -> bytes:
    form, _, _, void, predictor, period = way
    stream = encode_residuals(
        integers, flags_of(points, void), period, predictor, 64 if form == DECIMAL else width
    )
    return bytes([RESIDUALS]) + _RECORD.pack(*way, len(stream)) + stream


def _as_symbols(
    integers: Integers, points: Points, way: _Way, width: int, to_beat: int = ENDLESS
) -> bytes | None:
    """None where the integers are no symbols, or take more than the bytes ``to_beat``."""
    symbols = integers & 255 if width == 8 else integers
    if symbols.min() < 0 or symbols.max() > 255:
        return None
    stream = encode_symbols(symbols, flags_of(points, way[3]), way[5], to_beat)
    return stream and bytes([SYMBOLS]) + _RECORD.pack(*way, len(stream)) + stream


def decode_plain(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, base: Values | None
) -> tuple[Values, int]:
    """Inverse of :func:`encode_plain`: the values, and where the record at ``at`` ends."""
    require_sound(at + 1 + _RECORD.size <= len(data))
    form, scale, based, void, predictor, period, length = _RECORD.unpack_from(data, at + 1)
    start = at + 1 + _RECORD.size
    sound = (
        data[at] in (RESIDUALS, SYMBOLS)
        and form <= (DECIMAL if kind.kind == "f" else BITS)
        and scale < len(SCALES)
        and based < 2
        and void < 2
        and predictor < PREDICTORS
        and period in points.periods
        and start + length <= len(data)
    )
    require_sound(sound)
    width = 8 * kind.itemsize
    flags, stream = flags_of(points, void), data[start : start + length]
    if data[at] == RESIDUALS:
        bits_of = 64 if form == DECIMAL else width
        integers, sound = decode_residuals(flags, period, predictor, bits_of, stream)
    else:
        integers, sound = decode_symbols(flags, period, stream)
    require_sound(sound)
    if based:
        integers = integers + _base(kind, form, points, base)
    if form == DECIMAL:
        return from_scale(integers, scale, kind), start + length
    integers = _wrap(integers, width)
    return from_bits(order(integers, width) if form == ORDERED else integers, kind), start + length


def _forms(values: Values, points: Points, base: Values | None) -> list[tuple[int, int, int, Integers]]:
    """Return (form, scale, based, integers) to choose from."""
    kind, width = values.dtype, 8 * values.dtype.itemsize
    bits = to_bits(values)
    if kind.kind != "f":
        forms = [(BITS, 0, 0, bits)]
        if width >= 16:
            forms.append((BITS, 0, 1, bits - _base(kind, BITS, points, base)))
        return forms
    ordered = order(bits, width)
    if base is not None:
        return [(ORDERED, 0, 1, ordered - _base(kind, ORDERED, points, base))]
    scale = find_scale(values)
    if scale is not None:
        return [(DECIMAL, scale, 0, to_scale(values, scale))]
    return [(ORDERED, 0, 0, ordered), (ORDERED, 0, 1, ordered - _base(kind, ORDERED, points, None))]


def _base(kind: np.dtype[Any], form: int, points: Points, base: Values | None) -> Integers:
    """What a field is measured against: what was given, else the distance, in mm where it is an integer."""
    if form == BITS:
        return np.rint(points.ranges * 1000.0).astype(np.int64)
    near = points.ranges.astype(kind) if base is None else base
    # What becomes of a NaN on the way to another type differs between machines.
    return np.where(np.isnan(near), 0, order(to_bits(near), 8 * kind.itemsize))


def _wrap(integers: Integers, width: int) -> Integers:
    return (integers << (64 - width)) >> (64 - width)
