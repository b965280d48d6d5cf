"""A field that is told from where points lie: records of kinds BY_LASER, TIMES, TIMELINE and COLUMNS."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.buffer import ENDLESS, require_sound
from salpcc.stages.entropy.integers import encode_column
from salpcc.stages.entropy.number_forms import (
    BITS,
    DECIMAL,
    MOST_DIGITS,
    ORDERED,
    Spans,
    from_bits,
    from_spans,
    spans_as,
    spans_of,
    to_bits,
)
from salpcc.stages.lattice.layers import merged
from salpcc.stages.lists.aimed.aimed_layers import GONE
from salpcc.stages.residual_code.message.column_values import decode_columns, encode_columns, find_shifts
from salpcc.stages.residual_code.message.firing_times import (
    MOST_GRAIN,
    Clocked,
    decode_times,
    encode_times,
)
from salpcc.stages.residual_code.message.fit_delays import find_times
from salpcc.stages.residual_code.message.grid import Grid
from salpcc.stages.residual_code.message.laser_symbols import decode_by_laser, encode_by_laser
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import (
    BY_LASER,
    COLUMNS,
    TIMELINE,
    TIMES,
    Integers,
    Values,
    read_small,
    unpacked,
)

_BY_LASER = struct.Struct("<I")  # length
_TIMES = struct.Struct("<BBBqII")  # form, power of ten, grain, origin, lengths of delays and clocks
_GRAINS = {BITS: 0, ORDERED: 8, DECIMAL: 4}  # of times that are steps of a float64, of decimals
_TIMELINE = struct.Struct("<BBq")  # form, power of ten, origin
_COLUMNS = struct.Struct("<BqII")  # void, origin, lengths of shifts and values


def encode_laser_record(values: Values, points: Points) -> bytes | None:
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


def decode_laser_record(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    """Inverse of :func:`encode_laser_record`: the values, and where the record ends; ``at``: behind its kind."""
    ((length,), at) = unpacked(_BY_LASER, data, at)
    if points.fired is None or at + length > len(data):
        raise ArchiveError("payload does not decode")
    symbols, sound = decode_by_laser(points.fired.laser, points.fired.lasers, data[at : at + length])
    require_sound(sound)
    return from_bits(symbols, kind), at + length


def encode_times_record(
    values: Values, points: Points, to_beat: int, beside: Values | None = None
) -> bytes | None:
    """A field that goes on from firing to firing; None where it does not, or takes more than ``to_beat`` bytes by far.

    Args:
        beside: of the static layer, where the points are those of the movable one.
    """
    points, values, known = _with(beside, values, points)
    if values.dtype.itemsize < 4 or not points.on_lattice or points.fired is None:
        return None
    spans = spans_of(values)
    if spans is None:
        return None
    found = find_times(points.fired, spans.low, spans.high, _GRAINS[spans.form], to_beat, known)
    if found is None:
        return None
    return _times_record(spans, *found)


def _with(
    beside: Values | None, values: Values, points: Points
) -> tuple[Points, Values, NDArray[np.bool_] | None]:
    """The points that times are told of, their values, and which of these a reader has: those of both layers, where there is one ``beside``."""
    if beside is None or points.layered is None or points.sensor is None or beside.dtype != values.dtype:
        return points, values, None
    movable = points.layered.movable
    return points.whole, merged(movable, beside, values), ~movable


def encode_times_like(
    record: bytes, values: Values, points: Points, beside: Values | None = None
) -> bytes | None:
    """The same with the delays that ``record`` has; None where that cannot be."""
    _, _, grain, _, n_delays, _ = _TIMES.unpack_from(record, 1)
    points, values, known = _with(beside, values, points)
    if points.fired is None or values.dtype.itemsize < 4:
        return None
    start = 1 + _TIMES.size
    delay = read_small(points.fired.lasers + 1, record[start : start + n_delays])
    clocked = Clocked(grain, delay)
    spans = spans_of(values)
    stream = spans and encode_times(points.fired, spans.low, spans.high, clocked, known=known)
    return _times_record(spans, clocked, stream) if spans and stream else None


def _times_record(spans: Spans, clocked: Clocked, stream: bytes) -> bytes:
    delays = encode_column(clocked.delay)
    head = _TIMES.pack(spans.form, spans.power, clocked.grain, spans.origin, len(delays), len(stream))
    return bytes([TIMES]) + head + delays + stream


def decode_times_record(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, beside: Values | None = None
) -> tuple[Values, int]:
    """Inverse of :func:`encode_times_record`: the values, and where the record ends; ``at``: behind its kind."""
    (form, power, grain, origin, n_delays, length), at = unpacked(_TIMES, data, at)
    end = at + n_delays + length
    points, whole, known = _with(beside, np.zeros(len(points.void), kind), points)
    if points.fired is None or form > DECIMAL or power > MOST_DIGITS or grain > MOST_GRAIN or end > len(data):
        raise ArchiveError("payload does not decode")
    given = None
    if known is not None:
        spans = spans_as(whole, form, power, origin)
        if spans is None:
            raise ArchiveError("payload does not decode")
        given = spans.low, spans.high, known
    delay = read_small(points.fired.lasers + 1, data[at : at + n_delays])
    numbers, sound = decode_times(points.fired, Clocked(grain, delay), data[at + n_delays : end], given)
    require_sound(sound)
    values = from_spans(numbers, form, power, origin, kind)
    return values if known is None else values[~known], end


def encode_timeline_record(values: Values, points: Points) -> bytes | None:
    """The field that the times of the points are of; None where it is another."""
    if points.timeline is None or values.dtype.itemsize < 4:
        return None
    spans = spans_of(values)
    if spans is None:
        return None
    apart = spans.low - points.timeline.time  # a movable layer's are told from the static one's origin
    if (apart != apart[0]).any() or (apart[0] != 0 and spans.form != BITS):
        return None
    return bytes([TIMELINE]) + _TIMELINE.pack(spans.form, spans.power, spans.origin + int(apart[0]))


def decode_timeline_record(data: bytes, at: int, kind: np.dtype[Any], points: Points) -> tuple[Values, int]:
    """Inverse of :func:`encode_timeline_record`: the values, and where the record ends; ``at``: behind its kind."""
    (form, power, origin), at = unpacked(_TIMELINE, data, at)
    if points.timeline is None or form > DECIMAL or power > MOST_DIGITS or kind.itemsize < 4:
        raise ArchiveError("payload does not decode")
    return from_spans(points.timeline.time, form, power, origin, kind), at


def encode_column_record(
    values: Values, points: Points, to_beat: int, beside: Values | None = None
) -> bytes | None:
    """A field that follows from the column of an organised cloud; None where it is none, or takes more than ``to_beat`` bytes.

    Args:
        beside: of the static layer, where the points are those of the movable one.
    """
    if points.grid is None or not points.of_rows(values):
        return None
    grid, best = points.grid, None
    origin, bits = _in_rows(values, grid, beside)
    gone = grid.role == GONE
    for nothing in (grid.void, gone) if gone.any() else (grid.void,):  # where points are few, void ones count
        shifts = find_shifts(bits, nothing, grid.width, grid.role)
        for void in (0, 1) if points.void.any() else (0,):
            coded = _encode_columns_as(shifts, void, origin, bits, grid, to_beat)
            if coded is not None and (best is None or len(coded) < len(best)):
                best, to_beat = coded, len(coded)
    return best


def _in_rows(values: Values, grid: Grid, beside: Values | None) -> tuple[int, Integers]:
    """The bits of the first value, and by how much those of all places ``(W,)`` are off it."""
    bits = to_bits(values)
    given = to_bits(beside) if beside is not None and beside.dtype == values.dtype else None
    return int(bits[0]), grid.spread(bits, given) - bits[0]


def encode_columns_like(
    record: bytes, values: Values, points: Points, beside: Values | None = None
) -> bytes | None:
    """The same with the shifts that ``record`` has; None where that cannot be."""
    void, _, n_shifts, _ = _COLUMNS.unpack_from(record, 1)
    grid = points.grid
    if grid is None or not points.of_rows(values):
        return None
    start = 1 + _COLUMNS.size
    shifts = read_small(len(grid.role) // grid.width, record[start : start + n_shifts])
    return _encode_columns_as(shifts, void, *_in_rows(values, grid, beside), grid)


def _encode_columns_as(
    shifts: Integers, void: int, origin: int, bits: Integers, grid: Grid, to_beat: int = ENDLESS
) -> bytes | None:
    """The same with shifts that are known; None where values differ too much."""
    coded = encode_column(shifts)
    stream = encode_columns(bits, grid.void & bool(void), grid.width, shifts, to_beat, grid.role)
    if stream is None:
        return None
    return bytes([COLUMNS]) + _COLUMNS.pack(void, origin, len(coded), len(stream)) + coded + stream


def decode_column_record(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, beside: Values | None = None
) -> tuple[Values, int]:
    """Inverse of :func:`encode_column_record`: the values, and where the record ends; ``at``: behind its kind."""
    (void, origin, n_shifts, length), at = unpacked(_COLUMNS, data, at)
    end, grid = at + n_shifts + length, points.grid
    if grid is None or void > 1 or end > len(data) or len(points.void) == 0:
        raise ArchiveError("payload does not decode")
    shifts = read_small(len(grid.role) // grid.width, data[at : at + n_shifts])
    _, given = _in_rows(np.zeros(len(points.void), kind), grid, beside)
    integers, sound = decode_columns(
        grid.void & bool(void), grid.width, shifts, data[at + n_shifts : end], grid.role, given - origin
    )
    require_sound(sound)
    return from_bits(grid.own(integers) + origin, kind), end
