"""The mask of a movable layer: returns are looked for only where the static layer has none.

Cars and people are holes of the static layer, with returns in them; what the static layer has to the right and on the
ring below is known as well, so both ends of a hole are.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_bit,
    decode_mixed_bit,
    encode_bit,
    encode_mixed_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)
from salpcc.stages.residual_code.sensor.mask_coder import firing_context, follow, mark_firings, ticks_of_ring

FIRING_CONTEXTS = 1 + (1 << 6)  # whether the static layer lacks firings, then which
BEHIND_CONTEXTS = 3**6
AROUND_CONTEXTS = 3**4 * 2**6
RETURN_CONTEXTS = BEHIND_CONTEXTS + AROUND_CONTEXTS
_STATIC, _MOVABLE = 1, 2
_BEFORE, _AFTER = 3, 3  # places at the ends of a ring that are empty

Starts = NDArray[np.int64]
Ticks = NDArray[np.int32]


@njit(cache=True)
def _code_firings(decoding, coder, data, out, model, known, firing):  # type: ignore[no-untyped-def]
    """Code the firings that ``known`` lacks; ``firing`` is read, or filled when decoding."""
    more = 0
    if decoding:
        more = decode_bit(coder, data, model, 0)
    else:
        for t in range(len(firing)):
            if firing[t] != known[t]:
                more = 1
        encode_bit(coder, out, model, 0, more)
    for t in range(len(firing)):
        if known[t] == 1:
            firing[t] = 1
        elif more == 1:
            context = 1 + firing_context(firing, t)
            if decoding:
                firing[t] = decode_bit(coder, data, model, context)
            else:
                encode_bit(coder, out, model, context, firing[t])


@njit(cache=True)
def _walk(  # type: ignore[no-untyped-def]
    decoding, coder, data, out, fired, shift, ticks, known_starts, known_tick, starts, tick, laser, model
):
    """Code the returns of all rings; encoder and decoder are one walk. Returns how many there were, -1 for too many."""
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
    done = 0
    for k in range(rings):
        here = seen[k]
        up, up_places = (seen[k - 1], places[k - 1]) if k > 0 else (empty, none)
        up2, up2_places = (seen[k - 2], places[k - 2]) if k > 1 else (empty, none)
        down, down_places = (seen[k + 1], places[k + 1]) if k + 1 < rings else (empty, none)
        j = j2 = below = -1
        i = 0 if decoding else starts[k]
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
            if decoding:
                bit = decode_mixed_bit(coder, data, model, behind, model, around)
                if bit == 1:
                    if done == len(tick):
                        return -1
                    laser[done] = k
                    tick[done] = t
                    done += 1
            else:
                bit = 0
                if i < starts[k + 1] and tick[i] == t:
                    bit = 1
                    i += 1
                encode_mixed_bit(coder, out, model, behind, model, around, bit)
            here[at] = bit * _MOVABLE
    return done


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
    known, firing = np.zeros(ticks, np.int8), np.zeros(ticks, np.int8)
    mark_firings(known_starts, known_tick, shift, ticks, known)
    firing[:] = known
    mark_firings(starts, tick, shift, ticks, firing)
    coder = start_encoder()
    _code_firings(False, coder, out, out, firing_model, known, firing)
    fired = np.flatnonzero(firing)
    laser = np.zeros(0, np.uint8)
    _walk(
        False, coder, out, out, fired, shift, ticks, known_starts, known_tick, starts, tick, laser, return_model
    )  # fmt: skip
    return finish_encoder(coder, out)


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
    laser = np.zeros(n, np.uint8)
    tick = np.zeros(n, np.int32)
    known, firing = np.zeros(ticks, np.int8), np.zeros(ticks, np.int8)
    mark_firings(known_starts, known_tick, shift, ticks, known)
    coder = start_decoder(data)
    out = np.zeros(0, np.uint8)
    _code_firings(True, coder, data, out, firing_model, known, firing)
    fired = np.flatnonzero(firing)
    starts = np.zeros(0, np.int64)
    done = _walk(
        True, coder, data, out, fired, shift, ticks, known_starts, known_tick, starts, tick, laser, return_model
    )  # fmt: skip
    return laser, tick, done == n and coder[3] == 0
