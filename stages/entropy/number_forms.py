"""Fields of any type as signed integers whose neighbours differ little, and back to the same bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BITS, ORDERED, DECIMAL = range(3)  # forms: the bits, floats in their order, multiples of 1 / SCALES[i]
SCALES = (1.0, 10.0, 100.0, 1000.0, 1e6, 1e9, 255.0, 256.0)
Integers = NDArray[np.int64]
Values = NDArray[Any]


def to_bits(values: Values) -> Integers:
    """Return the bit patterns of values ``(N,)`` of any type, sign-extended."""
    return np.ascontiguousarray(values).view(f"i{values.dtype.itemsize}").astype(np.int64)


def from_bits(bits: Integers, kind: np.dtype[Any]) -> Values:
    """Inverse of :func:`to_bits`; higher bits are dropped."""
    return bits.astype(f"i{kind.itemsize}").view(kind)


def order(bits: Integers, width: int) -> Integers:
    """Map bit patterns of floats of ``width`` bits to integers in the order of the values; its own inverse."""
    return np.where(bits < 0, bits ^ ((1 << (width - 1)) - 1), bits)


def find_scale(values: Values) -> int | None:
    """Return the first of SCALES whose inverse divides all float values ``(N,)``, bit for bit."""
    for index in range(len(SCALES)):
        if _on_scale(values[:4096], index) and _on_scale(values, index):
            return index
    return None


def _on_scale(values: Values, index: int) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        near = np.abs(values.astype(np.float64)) * SCALES[index] < 1 << 53  # NaN is not
    if not near.all():
        return False
    again = from_scale(to_scale(values, index), index, values.dtype)
    return bool((to_bits(again) == to_bits(values)).all())


def to_scale(values: Values, index: int) -> Integers:
    """Return float values as multiples of ``1 / SCALES[index]``."""
    return np.rint(values.astype(np.float64) * SCALES[index]).astype(np.int64)


def from_scale(integers: Integers, index: int, kind: np.dtype[Any]) -> Values:
    """Inverse of :func:`to_scale`."""
    with np.errstate(over="ignore"):
        return (integers / SCALES[index]).astype(kind)


_POWERS = (12, 15, 9, 6, 3, 0)  # decimal places of float32 values
MOST_DIGITS = 15
_DIGITS = 9  # of float64 values, if they have no more
_SHIFT = 8  # binary places below the last bit of float64 values
_MOST = 1 << 47  # of whole numbers
_NUDGED = 4


@dataclass(frozen=True, eq=False)
class Spans:
    """The whole numbers ``low ... high (N,)`` that all mean a value: floats were rounded, and most have several.

    Attributes:
        form: DECIMAL: multiples of ``10 ** -power``; ORDERED: the bits with ``_SHIFT`` binary places more; BITS: the bits.
        origin: bits of the value that is 0; not of DECIMAL.
    """

    form: int
    power: int
    origin: int
    low: Integers
    high: Integers


def spans_of(values: Values) -> Spans | None:
    """Return what values ``(N,)`` may have been before they were rounded; None where they are spread too widely."""
    kind, bits = values.dtype, to_bits(values)
    if kind == np.float32:
        return _decimal_spans(values)
    if kind == np.float64:
        if np.isfinite(values).all() and np.abs(values).max() < _MOST / 10.0**_DIGITS:
            whole = np.rint(values * 10.0**_DIGITS).astype(np.int64)
            if (to_bits(from_spans(whole, DECIMAL, _DIGITS, 0, kind)) == bits).all():
                return Spans(DECIMAL, _DIGITS, 0, whole, whole)
        ordered = order(bits, 64)
        off = ordered - ordered[0]
        if np.abs(off / 2.0**_SHIFT).max() * 2.0 ** (2 * _SHIFT) >= _MOST or not np.isfinite(values).all():
            return None
        return spans_as(values, ORDERED, 0, int(ordered[0]))
    off = bits - bits[0]
    if np.abs(off / 2.0).max() * 2.0 >= _MOST:
        return None
    return spans_as(values, BITS, 0, int(bits[0]))


def spans_as(values: Values, form: int, power: int, origin: int) -> Spans | None:
    """Return the same of values ``(N,)`` in the form that others have; None where they have no such form."""
    if form == DECIMAL and values.dtype == np.float32:
        return _at_power(values, power)
    if form == DECIMAL:
        whole = np.rint(values * 10.0**power).astype(np.int64)
        return Spans(DECIMAL, power, 0, whole, whole)
    bits = to_bits(values)
    if form == BITS:
        return Spans(BITS, 0, origin, bits - origin, bits - origin)
    low = ((order(bits, 64) - origin) << _SHIFT) - (1 << (_SHIFT - 1))
    return Spans(ORDERED, 0, origin, low, low + (1 << _SHIFT) - 1)


def _decimal_spans(values: Values) -> Spans | None:
    if not np.isfinite(values).all():
        return None
    largest = float(np.abs(values).max())
    found = (_at_power(values, power) for power in _POWERS if largest * 10.0**power < _MOST)
    return next((spans for spans in found if spans is not None), None)


def _at_power(values: Values, power: int) -> Spans | None:
    unit = 10.0**power
    ends = []
    for way in (-1, 1):
        beyond = np.nextafter(values, np.float32(way * np.inf)).astype(np.float64)
        end = np.rint((values.astype(np.float64) + beyond) / 2 * unit).astype(np.int64) + way
        for _ in range(_NUDGED):
            end = np.where(from_spans(end, DECIMAL, power, 0, values.dtype) == values, end, end - way)
        if (to_bits(from_spans(end, DECIMAL, power, 0, values.dtype)) != to_bits(values)).any():
            return None
        ends.append(end)
    return Spans(DECIMAL, power, 0, *ends)


def from_spans(numbers: Integers, form: int, power: int, origin: int, kind: np.dtype[Any]) -> Values:
    """Return the values that whole numbers mean."""
    if form == DECIMAL:
        with np.errstate(over="ignore"):
            return (numbers / 10.0**power).astype(kind)
    width = 8 * kind.itemsize
    if form == ORDERED:
        return from_bits(order(((numbers + (1 << (_SHIFT - 1))) >> _SHIFT) + origin, width), kind)
    return from_bits(numbers + origin, kind)
