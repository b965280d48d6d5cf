"""One field of all points, coded in the form and by the prediction that cost least.

A record is self-contained: how the field was taken, then its stream. Constant fields take a few bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.columns import (
    PREDICTORS,
    costs,
    decode_residuals,
    encode_residuals,
)
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

CONSTANT, RESIDUALS, SYMBOLS = range(3)
_RECORD = struct.Struct("<BBBBBII")  # form, scale, based, void, predictor, period, length
_SAMPLE = 1 << 16
Values = NDArray[Any]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Points:
    """What encoder and decoder know of the points before their fields.

    Attributes:
        xyz: ``(N, 3)`` float32 as decoded.
        void: ``(N,)`` whether a point has no return: all zeros, or NaN.
        ranges: ``(N,)`` float64, distance from the sensor in metres, 0 where void.
        periods: distances at which fields may repeat.
    """

    xyz: NDArray[np.float32]
    void: NDArray[np.bool_]
    ranges: NDArray[np.float64]
    periods: tuple[int, ...]

    @classmethod
    def of(cls, xyz: NDArray[np.float32], width: int) -> Points:
        """Derive it from decoded points; ``width`` is that of a row of an organised cloud, else 0."""
        wide = xyz.astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            squares = (wide[:, 0] * wide[:, 0] + wide[:, 1] * wide[:, 1]) + wide[:, 2] * wide[:, 2]
            void = ~((squares > 0) & (squares < 1e12))
        ranges = np.sqrt(np.where(void, 0.0, squares))
        return cls(xyz, void, ranges, (1, width, 4 * width) if width > 1 else (1, 16, 32, 64, 128))


def encode_field(values: Values, points: Points, base: Values | None = None) -> bytes:
    """Encode a field ``(N,)`` of any number type, bit for bit.

    Args:
        base: values of the same type that it is close to, such as the coordinate it was rounded from.
    """
    bits = to_bits(values)
    if len(values) == 0 or (bits == bits[0]).all():
        return bytes([CONSTANT]) + values[:1].tobytes().ljust(values.dtype.itemsize, b"\0")
    width = 8 * values.dtype.itemsize
    best: tuple[int, tuple[int, int, int, int, int, int], Integers] | None = None
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
    form, _, _, void, predictor, period = way
    stream = encode_residuals(
        integers, _flags(points, void), period, predictor, 64 if form == DECIMAL else width
    )
    coded = bytes([RESIDUALS]) + _RECORD.pack(*way, len(stream)) + stream
    symbols = _as_symbols(integers, width)
    if symbols is not None:
        for period in points.periods:
            stream = encode_symbols(symbols, _flags(points, void), period)
            if len(stream) + 1 + _RECORD.size < len(coded):
                coded = bytes([SYMBOLS]) + _RECORD.pack(*way[:5], period, len(stream)) + stream
    return coded


def decode_field(
    data: bytes, at: int, kind: np.dtype[Any], points: Points, base: Values | None = None
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


def _as_symbols(integers: Integers, width: int) -> Integers | None:
    if width == 8:
        return integers & 255
    return integers if integers.min() >= 0 and integers.max() < 256 else None


def _wrap(integers: Integers, width: int) -> Integers:
    return (integers << (64 - width)) >> (64 - width)
