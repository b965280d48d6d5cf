"""Fields of any type as signed integers whose neighbours differ little, and back to the same bits."""

from __future__ import annotations

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
