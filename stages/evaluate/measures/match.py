"""Find which source points a decoded scan kept.

An archive keeps the file order and drops whole points, so what it decodes to is a subsequence of the source
within the error bound. Which points were dropped is not in the archive (it would cost bytes that no decoder
needs); who has the labels knows, and any other verifier finds them again by matching in order.

The earliest match is enough: if any in-order correspondence exists, taking for each decoded point the first
source point within the bound that is still free leaves every later choice open, so it finds one as well.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.scan import Scan

_SMALLEST = 1e-6  # metres; below the last float32 bit of a point at 16 m
_LARGEST = 1e3


def kept_points(source: Scan, decoded: Scan, max_error: float) -> NDArray[np.bool_] | None:
    """Mark the source points ``(N,)`` that the decoded scan keeps, or return None if no order fits.

    Tries the tightest bound first and goes on beyond ``max_error``, so that a codec that breaks its promise
    is still measured (with at most twice its true error) rather than unmeasured.
    """
    if len(source) == len(decoded):
        return np.ones(len(source), np.bool_)
    if len(decoded) > len(source):
        return None
    a = np.column_stack([source.points, source.intensity]).astype(np.float32, copy=False)
    b = np.column_stack([decoded.points, decoded.intensity]).astype(np.float32, copy=False)
    for bound in _bounds(max_error):
        kept, matched = match_in_order(a, b, a.view(np.uint32), b.view(np.uint32), bound)
        if matched == len(decoded):
            return np.asarray(kept)
    return None


def _bounds(max_error: float) -> Iterator[float]:
    """Yield 0, then bounds that double through ``max_error`` itself."""
    yield 0.0
    bound = max_error / 4 if max_error > 0 else _SMALLEST
    while bound <= _LARGEST:
        yield bound
        bound *= 2


@njit(cache=True)
def match_in_order(source, decoded, source_bits, decoded_bits, bound):  # type: ignore[no-untyped-def]
    """Match ``(M, 4)`` decoded points to ``(N, 4)`` source points, x, y, z, intensity float32.

    Two points match when they are equal bit for bit, or when their intensities are and their 3-D distance
    is at most ``bound`` metres. Returns the mask ``(N,)`` of matched source points, and their number.
    """
    kept = np.zeros(len(source), np.bool_)
    j = 0
    for i in range(len(source)):
        if j == len(decoded):
            break
        if source_bits[i, 3] != decoded_bits[j, 3]:
            continue
        squared = 0.0
        for axis in range(3):
            if source_bits[i, axis] != decoded_bits[j, axis]:
                difference = np.float64(decoded[j, axis]) - np.float64(source[i, axis])
                squared += difference * difference
        if squared <= bound * bound:  # false for NaN
            kept[i] = True
            j += 1
    return kept, j
