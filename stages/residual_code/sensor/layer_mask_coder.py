"""The mask of a movable layer: returns are looked for only where the static layer has none.

Cars and people are holes of the static layer, with returns in them; what the static layer has to the right and on the
ring below is known as well, so both ends of a hole are.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_bit, code_mixed_bit, finish_coder, start_coder, uncounted
from salpcc.stages.residual_code.sensor.mask_coder import (
    Ticks,
    firing_context,
    follow,
    is_return,
    mark_firings,
    note_return,
    ticks_of_ring,
)

FIRING_CONTEXTS = 1 + (1 << 6)  # whether the static layer lacks firings, then which
BEHIND_CONTEXTS = 3**6
AROUND_CONTEXTS = 3**4 * 2**6
RETURN_CONTEXTS = BEHIND_CONTEXTS + AROUND_CONTEXTS
_STATIC, _MOVABLE = 1, 2
_BEFORE, _AFTER = 3, 3  # places at the ends of a ring that are empty

Starts = NDArray[np.int64]


@uncounted
def _code_firings(
    writing: bool,
    state: NDArray[np.int64],
    model: NDArray[np.uint16],
    known: NDArray[np.int8],
    firing: NDArray[np.int8],
    buffer: NDArray[np.uint8],
) -> None:
    """Code the firings that ``known`` lacks; ``firing`` is read, or filled when reading."""
    more = 0
    if writing:
        for t in range(len(firing)):
            if firing[t] != known[t]:
                more = 1
    more = code_bit(writing, state, buffer, model, 0, more)
    for t in range(len(firing)):
        if known[t] == 1:
            firing[t] = 1
        elif more == 1:
            firing[t] = code_bit(writing, state, buffer, model, 1 + firing_context(firing, t), firing[t])


@njit(cache=True)
def _walk(
    writing: bool,
    known_starts: Starts,
    known_tick: Ticks,
    starts: Starts,
    tick: Ticks,
    laser: NDArray[np.uint8],
    shift: NDArray[np.int64],
    firing: NDArray[np.int8],
    firing_model: NDArray[np.uint16],
    return_model: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> tuple[int, int]:
    """Code firings and returns as :mod:`.mask_coder` does, with the same arguments, but for those of the static layer."""
    state = start_coder(writing, buffer)
    ticks = len(firing)
    known = np.zeros(ticks, np.int8)
    mark_firings(known_starts, known_tick, shift, ticks, known)
    _code_firings(writing, state, firing_model, known, firing, buffer)
    fired = np.flatnonzero(firing)
    n, rings = len(fired), len(shift)
    places = np.full((rings, n + 1), ticks)
    seen = np.zeros((rings, n + _BEFORE + _AFTER), np.int64)
    for k in range(rings):
        ticks_of_ring(fired, shift[k], ticks, places[k])
        f = 0
        for i in range(known_starts[k], known_starts[k + 1]):
            while places[k, f] < known_tick[i]:
                f += 1
            seen[k, f + _BEFORE] = _STATIC
    empty = np.zeros(n + _BEFORE + _AFTER, np.int64)
    none = np.full(n + 1, ticks)
    done = end = 0
    for k in range(rings):
        here = seen[k]
        up, up_places = (seen[k - 1], places[k - 1]) if k > 0 else (empty, none)
        up2, up2_places = (seen[k - 2], places[k - 2]) if k > 1 else (empty, none)
        down, down_places = (seen[k + 1], places[k + 1]) if k + 1 < rings else (empty, none)
        j = j2 = below = -1
        if writing:
            done, end = starts[k], starts[k + 1]
        for f in range(n):
            at, t = f + _BEFORE, places[k, f]
            if here[at] == _STATIC:
                continue
            j = follow(j, t, up_places)
            j2 = follow(j2, t, up2_places)
            below = follow(below, t, down_places)
            a, a2, b = j + _BEFORE, j2 + _BEFORE, below + _BEFORE
            left, above = here[at - 1], up[a]
            behind = ((((left * 3 + here[at - 2]) * 3 + here[at - 3]) * 3 + up[a - 1]) * 3 + above) * 3 + up[
                a + 1
            ]
            around = ((left * 3 + above) * 3 + up[a + 2]) * 3 + up2[a2]
            around = around << 6 | (
                here[at + 1] << 5
                | here[at + 2] << 4
                | here[at + 3] << 3
                | down[b - 1] << 2
                | down[b] << 1
                | down[b + 1]
            )
            around += BEHIND_CONTEXTS
            bit = is_return(writing, tick, done, end, t)
            bit = code_mixed_bit(writing, state, buffer, return_model, behind, return_model, around, bit)
            if bit == 1:
                if not note_return(writing, laser, tick, done, k, t):
                    return -1, -1
                done += 1
            here[at] = bit * _MOVABLE
    return done, finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_layer_mask(
    known_starts: Starts,
    known_tick: Ticks,
    starts: Starts,
    tick: Ticks,
    shift: NDArray[np.int64],
    ticks: int,
    firing_model: NDArray[np.uint16],
    return_model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode the ticks ``(M,)`` of a movable layer's returns; bytes written to ``out``, -1 if full.

    Args:
        known_starts, known_tick: the static layer's; no return is in both.
    """
    firing = np.zeros(ticks, np.int8)
    mark_firings(known_starts, known_tick, shift, ticks, firing)
    mark_firings(starts, tick, shift, ticks, firing)
    laser = np.zeros(0, np.uint8)
    return _walk(
        True, known_starts, known_tick, starts, tick, laser, shift, firing, firing_model, return_model, out
    )[1]  # fmt: skip


@njit(cache=True, nogil=True)
def decode_layer_mask(
    known_starts: Starts,
    known_tick: Ticks,
    shift: NDArray[np.int64],
    ticks: int,
    n: int,
    firing_model: NDArray[np.uint16],
    return_model: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], NDArray[np.int32], bool]:
    """Decode laser uint8 ``(n,)`` and tick int32 ``(n,)``, and whether the data gave exactly n returns."""
    laser, tick = np.zeros(n, np.uint8), np.zeros(n, np.int32)
    firing, starts = np.zeros(ticks, np.int8), np.zeros(0, np.int64)
    done, rest = _walk(
        False, known_starts, known_tick, starts, tick, laser, shift, firing, firing_model, return_model, data
    )  # fmt: skip
    return laser, tick, done == n and rest == 0
