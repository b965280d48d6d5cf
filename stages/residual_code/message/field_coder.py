"""One field of all points, coded in the form and by the prediction that cost least.

A record is self-contained: how the field was taken, then its stream. Constant fields take a few bytes.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.columns import (
    PREDICTORS,
    costs,
    decode_residuals,
    encode_residuals,
)
from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.entropy.number_forms import (
    BITS,
    DECIMAL,
    MOST_DIGITS,
    ORDERED,
    SCALES,
    Spans,
    find_scale,
    from_bits,
    from_scale,
    from_spans,
    order,
    spans_of,
    to_bits,
    to_scale,
)
from salpcc.stages.entropy.symbols import decode_symbols, encode_symbols
from salpcc.stages.residual_code.message.blended_values import (
    MOST,
    decode_blended,
    encode_blended,
)
from salpcc.stages.residual_code.message.column_values import decode_columns, encode_columns, find_shifts
from salpcc.stages.residual_code.message.firing_times import (
    Clocked,
    decode_times,
    encode_times,
    find_times,
)
from salpcc.stages.residual_code.message.laser_symbols import decode_by_laser, encode_by_laser
from salpcc.stages.residual_code.message.learned_values import LearnedField
from salpcc.stages.residual_code.message.points import FIRED, GUIDED, LISTED, ROWS, Points

CONSTANT, RESIDUALS, SYMBOLS, BY_LASER, TIMES, COLUMNS, TOLD, BLENDED, LEARNED = range(9)
_RECORD = struct.Struct("<BBBBBII")  # form, scale, based, void, predictor, period, length
_BY_LASER = struct.Struct("<I")  # length
_TIMES = struct.Struct("<BBBIqII")  # form, power of ten, shifted, apart, origin, lengths of delays and clocks
_BLENDED = struct.Struct("<BBBI")  # what lies around, form, scale, length
_TOLD = struct.Struct("<BBq")  # form, power of ten, origin
_COLUMNS = struct.Struct("<BqII")  # void, origin, lengths of shifts and values
_FEWEST = 500  # values; delays, shifts and the like of fewer cost more than they save
_WORTH_IT = 0.05  # bits a value; fields that take less are left
_SAMPLE = 1 << 16
Values = NDArray[Any]
Integers = NDArray[np.int64]
_Way = tuple[int, int, int, int, int, int]  # form, scale, based, void, predictor, period


def encode_field(
    values: Values, points: Points, base: Values | None = None, learned: LearnedField | None = None
) -> bytes:
    """Encode a field ``(N,)`` of any number type, bit for bit.

    Args:
        base: values of the same type that it is close to, such as the coordinate it was rounded from.
        learned: of this field before, for efforts above ``fast``.
    """
    known = _encode_known(values, points)
    if known is not None:
        return known
    width = 8 * values.dtype.itemsize
    best: tuple[int, _Way, Integers] | None = None
    for form, scale, based, integers in _forms(values, points, base):
        bits_of = 64 if form == DECIMAL else width
        wrapped = _wrap(integers, bits_of)
        for void in (0, 1) if points.void.any() else (0,):
            flags = _flags(points, void)[:_SAMPLE]
            for period in points.periods:
                found = costs(wrapped[:_SAMPLE], flags, period, bits_of)
                for predictor in range(PREDICTORS):
                    if best is None or found[predictor] < best[0]:
                        way = (form, scale, based, void, predictor, period)
                        best = int(found[predictor]), way, wrapped
    assert best is not None
    _, way, integers = best
    coded = _as_residuals(integers, points, way, width)
    for period in points.periods:
        other = _as_symbols(integers, points, (*way[:5], period), width)
        coded = coded if other is None else min(coded, other, key=len)
    if base is not None or len(values) < _FEWEST or 8 * len(coded) < _WORTH_IT * len(values):
        return coded
    for other in (
        _encode_by_laser(values, points),
        _encode_columns(values, points),
        _encode_blended(values, points, learned),
    ):
        coded = coded if other is None else min(coded, other, key=len)
    other = _encode_times(values, points, len(coded))
    return coded if other is None else min(coded, other, key=len)


def encode_like(
    record: bytes,
    values: Values,
    points: Points,
    base: Values | None = None,
    learned: LearnedField | None = None,
) -> bytes | None:
    """Encode a field as ``record`` of the scan before has it; None where that cannot be.

    Args:
        base, learned: as for :func:`encode_field`.
    """
    known = _encode_known(values, points)
    if known is not None:
        return known
    form = record[0]
    if form in (RESIDUALS, SYMBOLS):
        return _like_record(form, _RECORD.unpack_from(record, 1)[:6], values, points, base)
    if form == BY_LASER:
        return _encode_by_laser(values, points)
    if form == TIMES:
        *_, shifted, apart, _, n_delays, _ = _TIMES.unpack_from(record, 1)
        if points.fired is None:
            return None
        start = 1 + _TIMES.size
        delay = _read_small(points.fired.lasers + 1, record[start : start + n_delays])
        return _encode_times_as(Clocked(bool(shifted), apart, delay), values, points)
    if form == COLUMNS:
        void, _, n_shifts, _ = _COLUMNS.unpack_from(record, 1)
        if not points.of_rows(values):
            return None
        start = 1 + _COLUMNS.size
        rows = len(values) // points.width
        return _encode_columns_as(_read_small(rows, record[start : start + n_shifts]), void, values, points)
    if form in (BLENDED, LEARNED):
        return _encode_blended_as([_BLENDED.unpack_from(record, 1)[0]], values, points, learned)
    return None


def _like_record(form: int, way: _Way, values: Values, points: Points, base: Values | None) -> bytes | None:
    width = 8 * values.dtype.itemsize
    for *taken, integers in _forms(values, points, base):
        if tuple(taken) == way[:3] and way[5] in points.periods:
            wrapped = _wrap(integers, 64 if way[0] == DECIMAL else width)
            return (_as_residuals if form == RESIDUALS else _as_symbols)(wrapped, points, way, width)
    return None


def _as_residuals(integers: Integers, points: Points, way: _Way, width: int) -> bytes:
    form, _, _, void, predictor, period = way
    stream = encode_residuals(
        integers, _flags(points, void), period, predictor, 64 if form == DECIMAL else width
    )
    return bytes([RESIDUALS]) + _RECORD.pack(*way, len(stream)) + stream


def _as_symbols(integers: Integers, points: Points, way: _Way, width: int) -> bytes | None:
    """None where the integers are no symbols."""
    symbols = integers & 255 if width == 8 else integers
    if symbols.min() < 0 or symbols.max() > 255:
        return None
    stream = encode_symbols(symbols, _flags(points, way[3]), way[5])
    return bytes([SYMBOLS]) + _RECORD.pack(*way, len(stream)) + stream


def _encode_by_laser(values: Values, points: Points) -> bytes | None:
    """A field of small numbers that follow from the laser; None where it is none."""
    if values.dtype.kind == "f" or not points.on_lattice or points.fired is None:
        return None
    symbols = to_bits(values)
    if values.dtype.itemsize == 1:
        symbols = symbols & 255
    if symbols.min() < 0 or symbols.max() > 255:
        return None
    stream = encode_by_laser(symbols, points.fired.laser, points.fired.lasers)
    return bytes([BY_LASER]) + _BY_LASER.pack(len(stream)) + stream


def _encode_times(values: Values, points: Points, to_beat: int) -> bytes | None:
    """A field that goes on from firing to firing; None where it does not, or takes more than ``to_beat`` bytes by far."""
    if values.dtype.itemsize < 4 or not points.on_lattice or points.fired is None:
        return None
    spans = spans_of(values)
    if spans is None:
        return None
    found = find_times(points.fired, spans.low, spans.high, to_beat)
    if found is None:
        return None
    return _times_record(spans, *found)


def _encode_times_as(clocked: Clocked, values: Values, points: Points) -> bytes | None:
    """The same with delays that are known; None where they do not fit."""
    spans = spans_of(values) if values.dtype.itemsize >= 4 and points.fired is not None else None
    stream = spans and points.fired and encode_times(points.fired, spans.low, spans.high, clocked)
    return _times_record(spans, clocked, stream) if spans and stream else None


def _times_record(spans: Spans, clocked: Clocked, stream: bytes) -> bytes:
    delays = _small(clocked.delay)
    head = _TIMES.pack(
        spans.form, spans.power, clocked.shifted, clocked.apart, spans.origin, len(delays), len(stream)
    )
    return bytes([TIMES]) + head + delays + stream


def _encode_known(values: Values, points: Points) -> bytes | None:
    """A field that costs nothing: of one value, or the times that the points tell; None where it is another."""
    bits = to_bits(values)
    if len(values) == 0 or (bits == bits[0]).all():
        return bytes([CONSTANT]) + values[:1].tobytes().ljust(values.dtype.itemsize, b"\0")
    return _encode_told(values, points)


def _encode_told(values: Values, points: Points) -> bytes | None:
    """The field that the times of the points are of; None where it is another."""
    if points.told is None or values.dtype.itemsize < 4:
        return None
    spans = spans_of(values)
    if spans is None or (spans.low != points.told.time).any():
        return None
    return bytes([TOLD]) + _TOLD.pack(spans.form, spans.power, spans.origin)


def _encode_columns(values: Values, points: Points) -> bytes | None:
    """A field that follows from the column of an organised cloud; None where it is none."""
    if not points.of_rows(values):
        return None
    bits = to_bits(values)
    shifts = find_shifts(bits - bits[0], points.void, points.width)
    kinds = (0, 1) if points.void.any() else (0,)
    coded = [_encode_columns_as(shifts, void, values, points) for void in kinds]
    return min((one for one in coded if one is not None), key=len, default=None)


def _encode_columns_as(shifts: Integers, void: int, values: Values, points: Points) -> bytes | None:
    """The same with shifts that are known; None where values differ too much."""
    bits = to_bits(values)
    told = _small(shifts)
    stream = encode_columns(bits - bits[0], _flags(points, void), points.width, shifts)
    if stream is None:
        return None
    return bytes([COLUMNS]) + _COLUMNS.pack(void, int(bits[0]), len(told), len(stream)) + told + stream


def _encode_blended(values: Values, points: Points, learned: LearnedField | None) -> bytes | None:
    """A field that looks like a picture; None where its values are no whole numbers, or too large."""
    ways = [ROWS] * (points.width > 1) + [FIRED] * points.on_lattice or [LISTED]
    return _encode_blended_as([*ways, *(way + GUIDED for way in ways)], values, points, learned)


def _encode_blended_as(
    ways: list[int], values: Values, points: Points, learned: LearnedField | None
) -> bytes | None:
    """The same by the best of these neighbourhoods."""
    if values.dtype.kind != "f":
        form, scale, integers = BITS, 0, values.astype(np.int64)
    else:
        found = find_scale(values)
        if found is None:
            return None
        form, scale, integers = DECIMAL, found, to_scale(values, found)
    if integers.min() <= -MOST or integers.max() >= MOST:
        return None
    coded = []
    for what in ways:
        around = points.around(what)
        if around is not None:
            stream = encode_blended(
                integers, around, None if learned is None else learned.walk(what, around, *points.ticks(what))
            )
            kind = BLENDED if learned is None else LEARNED
            coded.append(bytes([kind]) + _BLENDED.pack(what, form, scale, len(stream)) + stream)
    return min(coded, key=len, default=None)


def learned_way(record: bytes) -> int | None:
    """What a record was learned around; None where it was not."""
    return int(_BLENDED.unpack_from(record, 1)[0]) if record[0] == LEARNED else None


def _decode_blended(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, learned: LearnedField | None = None
) -> tuple[Values, int]:
    (what, form, scale, length), at = _unpacked(_BLENDED, data, at)
    around = points.around(what) if what <= ROWS + GUIDED else None
    sound = form == (DECIMAL if kind.kind == "f" else BITS) and scale < len(SCALES)
    if around is None or not sound or at + length > len(data):
        raise ArchiveError("payload does not decode")
    walk = None if learned is None else learned.walk(what, around, *points.ticks(what))
    integers, sound = decode_blended(around, data[at : at + length], walk)
    if learned is not None:
        learned.settle(what)
    if not sound:
        raise ArchiveError("payload does not decode")
    return from_scale(integers, scale, kind) if form == DECIMAL else from_bits(integers, kind), at + length


def _small(values: Integers) -> bytes:
    return run_encoder(
        lambda out: int(encode_integers(values[:, None], integer_model(1), out)), 16 * len(values)
    )


def _read_small(n: int, data: bytes) -> Integers:
    rows, sound = decode_integers(n, 1, integer_model(1), np.frombuffer(bytearray(data), np.uint8))
    if not sound:
        raise ArchiveError("payload does not decode")
    return rows[:, 0]


def _decode_by_laser(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    ((length,), at) = _unpacked(_BY_LASER, data, at)
    if points.fired is None or at + length > len(data):
        raise ArchiveError("payload does not decode")
    symbols, sound = decode_by_laser(points.fired.laser, points.fired.lasers, data[at : at + length])
    if not sound:
        raise ArchiveError("payload does not decode")
    return from_bits(symbols, kind), at + length


def _decode_times(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    (form, power, shifted, apart, origin, n_delays, length), at = _unpacked(_TIMES, data, at)
    end = at + n_delays + length
    if points.fired is None or form > DECIMAL or power > MOST_DIGITS or shifted > 1 or end > len(data):
        raise ArchiveError("payload does not decode")
    delay = _read_small(points.fired.lasers + 1, data[at : at + n_delays])
    numbers, sound = decode_times(
        points.fired, Clocked(bool(shifted), apart, delay), data[at + n_delays : end]
    )
    if not sound:
        raise ArchiveError("payload does not decode")
    return from_spans(numbers, form, power, origin, kind), end


def _decode_told(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    (form, power, origin), at = _unpacked(_TOLD, data, at)
    if points.told is None or form > DECIMAL or power > MOST_DIGITS or kind.itemsize < 4:
        raise ArchiveError("payload does not decode")
    return from_spans(points.told.time, form, power, origin, kind), at


def _decode_columns(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    (void, origin, n_shifts, length), at = _unpacked(_COLUMNS, data, at)
    end = at + n_shifts + length
    n = len(points.void)
    if points.width < 2 or n % points.width or void > 1 or end > len(data):
        raise ArchiveError("payload does not decode")
    shifts = _read_small(n // points.width, data[at : at + n_shifts])
    integers, sound = decode_columns(_flags(points, void), points.width, shifts, data[at + n_shifts : end])
    if not sound:
        raise ArchiveError("payload does not decode")
    return from_bits(_wrap(integers + origin, 8 * kind.itemsize), kind), end


def _unpacked(what: struct.Struct, data: bytes, at: int) -> tuple[tuple[Any, ...], int]:
    if at + what.size > len(data):
        raise ArchiveError("payload does not decode")
    return what.unpack_from(data, at), at + what.size


_DECODE = {
    BY_LASER: _decode_by_laser,
    TIMES: _decode_times,
    COLUMNS: _decode_columns,
    TOLD: _decode_told,
    BLENDED: _decode_blended,
}


def decode_field(
    data: bytes,
    at: int,
    kind: np.dtype[Any],
    points: Points,
    base: Values | None = None,
    learned: LearnedField | None = None,
) -> tuple[Values, int]:
    """Inverse of :func:`encode_field`: the values, and where the record at ``at`` ends.

    Raises:
        ArchiveError: the record is damaged.
    """
    n = len(points.void)
    if at + 1 + kind.itemsize > len(data):
        raise ArchiveError("payload does not decode")
    if data[at] == CONSTANT:
        end = at + 1 + kind.itemsize
        return np.full(n, np.frombuffer(data, kind, 1, at + 1)[0]), end
    if data[at] == LEARNED and learned is not None:
        return _decode_blended(data, at + 1, kind, points, learned)
    if data[at] in _DECODE:
        return _DECODE[data[at]](data, at + 1, kind, points)
    if at + 1 + _RECORD.size > len(data):
        raise ArchiveError("payload does not decode")
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
    if not sound:
        raise ArchiveError("payload does not decode")
    width = 8 * kind.itemsize
    flags, stream = _flags(points, void), data[start : start + length]
    if data[at] == RESIDUALS:
        bits_of = 64 if form == DECIMAL else width
        integers, sound = decode_residuals(flags, period, predictor, bits_of, stream)
    else:
        integers, sound = decode_symbols(flags, period, stream)
    if not sound:
        raise ArchiveError("payload does not decode")
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


def _flags(points: Points, void: int) -> NDArray[np.bool_]:
    return points.void if void else np.zeros(len(points.void), np.bool_)


def _wrap(integers: Integers, width: int) -> Integers:
    return (integers << (64 - width)) >> (64 - width)
