"""A field as integers that are predicted from those before them: records of kinds RESIDUALS and SYMBOLS."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

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

_RECORD = struct.Struct("<BBBBBII")  # a _Head, length
_SAMPLE = 1 << 15
_LITTLE = 0.002  # bits a value; what takes so few needs no other form
_FEWEST = 500  # values of a field of decimals for which others are tried
_BESIDE_AXIS = 100.0  # millimetres that ranges are from distances, where beams start beside the axis
# What integers are measured against; the last two: by the sensor.
_PLAIN, _DISTANCE, _RANGE, _AZIMUTH = range(4)


class _Head(NamedTuple):
    """How a record takes its field; the length of its stream follows."""

    form: int
    scale: int
    based: int
    void: int
    predictor: int
    period: int

    def bits_of(self, kind: np.dtype[Any]) -> int:
        """Bits of its integers."""
        return 64 if self.form == DECIMAL else 8 * kind.itemsize


def encode_plain(values: Values, points: Points, base: Values | None) -> bytes:
    """Encode a field by the form and the prediction that cost least."""
    best: tuple[int, _Head, Integers] | None = None
    part = _middle(len(values))
    for form, scale, based, integers in _forms(values, points, base):
        if best is not None and best[0] <= _LITTLE * min(len(values), _SAMPLE):
            break
        bits_of = 64 if form == DECIMAL else 8 * values.dtype.itemsize
        wrapped = _wrap(integers, bits_of)
        for void in (0, 1) if points.void.any() else (0,):
            flags = flags_of(points, void)[part]
            for period in points.periods:
                least = ENDLESS if best is None else best[0]
                found = costs(wrapped[part], flags, period, bits_of, least)
                for predictor in range(PREDICTORS):
                    if best is None or found[predictor] < best[0]:
                        head = _Head(form, scale, based, void, predictor, period)
                        best = int(found[predictor]), head, wrapped
    assert best is not None
    _, head, integers = best
    coded = _as_residuals(integers, points, head, values.dtype)
    if best[0] <= _LITTLE * min(len(values), _SAMPLE):
        return coded
    head = head._replace(period=_period_of_symbols(integers, points, head, values.dtype))
    other = _as_symbols(integers, points, head, values.dtype, len(coded))
    return coded if other is None else min(coded, other, key=len)


def _middle(n: int) -> slice:
    """Of so many values, those in the middle that tell of all: the first may be sky."""
    begin = max(n - _SAMPLE, 0) // 2
    return slice(begin, begin + _SAMPLE)


def _period_of_symbols(integers: Integers, points: Points, head: _Head, kind: np.dtype[Any]) -> int:
    """The period by which symbols take least."""
    sample = _middle(len(integers))
    part, void = integers[sample], flags_of(points, head.void)[sample]
    symbols = part & 255 if kind.itemsize == 1 else part
    if symbols.min() < 0 or symbols.max() > 255:
        return head.period
    best, least = head.period, ENDLESS
    for period in points.periods:
        stream = encode_symbols(symbols, void, period, least)
        if stream is not None and len(stream) < least:
            best, least = period, len(stream)
    return best


def encode_plain_like(record: bytes, values: Values, points: Points, base: Values | None) -> bytes | None:
    """The same as ``record`` has it; None where that cannot be."""
    head = _Head(*_RECORD.unpack_from(record, 1)[:6])
    for *taken, integers in _forms(values, points, base):
        if tuple(taken) == head[:3] and head.period in points.periods:
            encode = _as_residuals if record[0] == RESIDUALS else _as_symbols
            return encode(_wrap(integers, head.bits_of(values.dtype)), points, head, values.dtype)
    return None


def _as_residuals(integers: Integers, points: Points, head: _Head, kind: np.dtype[Any]) -> bytes:
    flags = flags_of(points, head.void)
    stream = encode_residuals(integers, flags, head.period, head.predictor, head.bits_of(kind))
    return bytes([RESIDUALS]) + _RECORD.pack(*head, len(stream)) + stream


def _as_symbols(
    integers: Integers, points: Points, head: _Head, kind: np.dtype[Any], to_beat: int = ENDLESS
) -> bytes | None:
    """None where the integers are no symbols, or take more than the bytes ``to_beat``."""
    symbols = integers & 255 if kind.itemsize == 1 else integers
    if symbols.min() < 0 or symbols.max() > 255:
        return None
    stream = encode_symbols(symbols, flags_of(points, head.void), head.period, to_beat)
    return stream and bytes([SYMBOLS]) + _RECORD.pack(*head, len(stream)) + stream


def decode_plain(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, base: Values | None
) -> tuple[Values, int]:
    """Inverse of :func:`encode_plain`: the values, and where the record at ``at`` ends."""
    require_sound(at + 1 + _RECORD.size <= len(data))
    *fields, length = _RECORD.unpack_from(data, at + 1)
    head = _Head(*fields)
    start = at + 1 + _RECORD.size
    sound = (
        data[at] in (RESIDUALS, SYMBOLS)
        and head.form <= (DECIMAL if kind.kind == "f" else BITS)
        and head.scale < len(SCALES)
        and head.based <= _AZIMUTH
        and (head.based <= _DISTANCE or _is_known(head, points))
        and head.void < 2
        and head.predictor < PREDICTORS
        and head.period in points.periods
        and start + length <= len(data)
    )
    require_sound(sound)
    flags, stream = flags_of(points, head.void), data[start : start + length]
    if data[at] == RESIDUALS:
        integers, sound = decode_residuals(flags, head.period, head.predictor, head.bits_of(kind), stream)
    else:
        integers, sound = decode_symbols(flags, head.period, stream)
    require_sound(sound)
    if head.based:
        integers = integers + _base(kind, head.form, points, base, head.based)
    if head.form == DECIMAL:
        return from_scale(integers, head.scale, kind), start + length
    width = head.bits_of(kind)
    integers = _wrap(integers, width)
    return from_bits(order(integers, width) if head.form == ORDERED else integers, kind), start + length


def _is_known(head: _Head, points: Points) -> bool:
    """Tell whether there is what a record says that its integers are measured against, by the sensor."""
    if head.form == BITS:
        return head.based == _RANGE and points.counted is not None
    return head.form == ORDERED and points.measured is not None


def _forms(values: Values, points: Points, base: Values | None) -> list[tuple[int, int, int, Integers]]:
    """Return (form, scale, based, integers) to choose from."""
    kind, width = values.dtype, 8 * values.dtype.itemsize
    bits = to_bits(values)
    if kind.kind != "f":
        forms = [(BITS, 0, _PLAIN, bits)]
        if width >= 16:
            forms.append((BITS, 0, _DISTANCE, bits - _base(kind, BITS, points, base)))
            if np.abs(forms[-1][3]).mean() < _BESIDE_AXIS and points.counted is not None:
                forms.append((BITS, 0, _RANGE, bits - _base(kind, BITS, points, base, _RANGE)))
        return forms
    ordered = order(bits, width)
    if base is not None:
        return [(ORDERED, 0, _DISTANCE, ordered - _base(kind, ORDERED, points, base))]
    scale = find_scale(values)
    decimal = [] if scale is None else [(DECIMAL, scale, _PLAIN, to_scale(values, scale))]
    if decimal and len(values) < _FEWEST:
        return decimal
    against = [_DISTANCE]
    if points.on_lattice and points.measured is not None:
        against += [_RANGE, _AZIMUTH]
    # Of long fields others are tried, too: a billionth divides any float32 that is not small.
    forms = [(ORDERED, 0, what, ordered - _base(kind, ORDERED, points, None, what)) for what in against]
    return [*decimal, (ORDERED, 0, _PLAIN, ordered), *forms]


def _base(
    kind: np.dtype[Any], form: int, points: Points, base: Values | None, what: int = _DISTANCE
) -> Integers:
    """What a field is measured against: what was given, else the distance, in mm where it is an integer, or range or azimuth by the sensor."""
    if form == BITS:
        ranges = points.ranges if what == _DISTANCE or points.counted is None else points.counted
        return np.rint(ranges * 1000.0).astype(np.int64)
    near = points.ranges.astype(kind) if base is None else base
    if what > _DISTANCE and points.measured is not None:
        near = points.measured[what - _RANGE].astype(kind)
    # What becomes of a NaN on the way to another type differs between machines.
    return np.where(np.isnan(near), 0, order(to_bits(near), 8 * kind.itemsize))


def _wrap(integers: Integers, width: int) -> Integers:
    return (integers << (64 - width)) >> (64 - width)
