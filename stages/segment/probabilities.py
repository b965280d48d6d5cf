"""From a network's logits to probabilities of groups: softmax, summed up in one pass over the image."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUPS

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

_LANES = 128  # pixels side by side: all loops run over them, which a compiler makes vectors of
_LOG2_E = np.float32(np.log2(np.e))
_GROUPS = len(GROUPS)
_DIGITS = np.float32(4096)


@njit(cache=True)
def group_probabilities(logits: F32, index: NDArray[np.int32], group_of: U8) -> tuple[F32, U8]:
    """Sum the probabilities of the classes up to groups.

    Args:
        logits: ``(H, W, C)`` of classes 1 to C.
        index: ``(H, W)``, below 0 where there is no return.
        group_of: ``(C + 1,)``, the group of each class.

    Returns:
        The probability of each group ``(3, H, W)``, in steps of 1/4096 so that the last bits of a processor's
        arithmetic decide nothing, and its most probable class; 0 where there is no return.
    """
    rows, columns, classes = logits.shape
    groups = np.zeros((_GROUPS, rows, columns), np.float32)
    best = np.zeros((_GROUPS, rows, columns), np.uint8)
    x = np.zeros((classes, _LANES), np.float32)
    top, whole = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
    exponent = np.empty(_LANES, np.int32)
    power = exponent.view(np.float32)
    total, most = np.empty((_GROUPS, _LANES), np.float32), np.empty((_GROUPS, _LANES), np.float32)
    at = np.empty((_GROUPS, _LANES), np.int32)
    for i in range(rows):
        for start in range(0, columns, _LANES):
            here = min(_LANES, columns - start)
            for lane in range(here):
                for k in range(classes):
                    x[k, lane] = logits[i, start + lane, k]
            top[:] = -np.inf
            for k in range(classes):
                for lane in range(_LANES):
                    top[lane] = max(top[lane], x[k, lane])
            whole[:] = 0
            total[:] = 0
            most[:] = -1
            for k in range(classes):
                group = group_of[k + 1]
                for lane in range(_LANES):
                    # A power of two: its whole part is an exponent, the rest goes by a polynomial (to 2e-7).
                    y = max((x[k, lane] - top[lane]) * _LOG2_E, np.float32(-126.0))
                    floor = np.floor(y)
                    f = y - floor
                    p = np.float32(1.8775767e-3)
                    p = p * f + np.float32(8.9893397e-3)
                    p = p * f + np.float32(5.5826318e-2)
                    p = p * f + np.float32(2.4015361e-1)
                    p = p * f + np.float32(6.9315308e-1)
                    x[k, lane] = p * f + np.float32(9.9999994e-1)
                    exponent[lane] = (np.int32(floor) + np.int32(127)) << np.int32(23)
                for lane in range(_LANES):
                    p = x[k, lane] * power[lane]
                    whole[lane] += p
                    total[group, lane] += p
                    better = p > most[group, lane]
                    most[group, lane] = p if better else most[group, lane]
                    at[group, lane] = np.int32(k + 1) if better else at[group, lane]
            for group in range(_GROUPS):
                for lane in range(here):
                    if index[i, start + lane] >= 0:
                        share = total[group, lane] / whole[lane]
                        groups[group, i, start + lane] = np.rint(share * _DIGITS) / _DIGITS
                        best[group, i, start + lane] = at[group, lane]
    return groups, best
