"""Which firings a scan has, and which of them each laser saw return.

All lasers share the firing ticks up to a constant shift per laser, so a scan is a bitmap of about
2,160 firings in 4,000 ticks and a bitmap of returns per laser. A missing return is a hole in the
scene (sky, glass, a dark car), and holes continue along the ring and from the ring above.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_bit,
    encode_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)

FIRING_CONTEXTS = 1 << 6
RETURN_CONTEXTS = 1 << 9


@njit(cache=True)
def firing_context(firing: NDArray[np.int8], t: int) -> int:
    """The six ticks before t: firings come every 2 ticks, sometimes 1."""
    context = 0
    for back in range(1, 7):
        context = (context << 1) | (firing[t - back] if t >= back else 0)
    return context


@njit(cache=True)
def mark_firings(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    shift: NDArray[np.int64],
    ticks: int,
    firing: NDArray[np.int8],
) -> None:
    """Set the firings ``(ticks,)`` that returns are of."""
    for k in range(len(starts) - 1):
        turn = shift[k] % ticks
        for i in range(starts[k], starts[k + 1]):
            t = tick[i] - turn
            if t < 0:
                t += ticks
            firing[t] = 1


@njit(cache=True)
def ticks_of_ring(fired: NDArray[np.int64], shift: int, ticks: int, out: NDArray[np.int64]) -> None:
    """Ticks at which a laser saw the firings ``fired`` (ascending), ascending themselves."""
    turn = shift % ticks
    stay = np.searchsorted(fired, ticks - turn)  # the shift pushes the others past the end of the turn
    for i in range(stay, len(fired)):
        out[i - stay] = fired[i] + turn - ticks
    for i in range(stay):
        out[len(fired) - stay + i] = fired[i] + turn


@njit(cache=True)
def follow(place: int, tick: int, ring_ticks: NDArray[np.int64]) -> int:
    """Move along a ring from firing ``place`` (-1: before the first) to the last at or before ``tick``."""
    while ring_ticks[place + 1] <= tick:  # a sentinel ends the ring
        place += 1
    return place


@njit(cache=True)
def _three(seen: NDArray[np.int64], place: int) -> int:
    """What a ring saw at firing ``place`` and the two after; ``seen`` stands one place to the right."""
    return seen[place + 1] << 2 | seen[place + 2] << 1 | seen[place + 3]


@njit(cache=True)
def _walk(  # type: ignore[no-untyped-def]
    decoding, coder, data, out, fired, shift, ticks, starts, tick, laser, model
):
    """Code the returns of all rings; encoder and decoder are one walk. Returns how many there were."""
    n = len(fired)
    ring_ticks = np.full((3, n + 1), ticks)
    seen = np.zeros((3, n + 4), np.int64)
    done = 0
    for k in range(len(shift)):
        places, above_places, above2_places = (
            ring_ticks[k % 3],
            ring_ticks[(k + 2) % 3],
            ring_ticks[(k + 1) % 3],
        )
        here, up, up2 = seen[k % 3], seen[(k + 2) % 3], seen[(k + 1) % 3]
        ticks_of_ring(fired, shift[k], ticks, places)
        left = 7
        at = -1
        at2 = -1
        i = 0 if decoding else starts[k]
        for f in range(n):
            t = places[f]
            at = follow(at, t, above_places)
            at2 = follow(at2, t, above2_places)
            context = left << 6 | _three(up, at) << 3 | _three(up2, at2)
            if decoding:
                bit = decode_bit(coder, data, model, context)
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
                encode_bit(coder, out, model, context, bit)
            here[f + 1] = bit
            left = (left << 1 | bit) & 7
    return done


@njit(cache=True)
def encode_mask(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    shift: NDArray[np.int64],
    ticks: int,
    firing_model: NDArray[np.uint16],
    return_model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode the ticks ``(M,)`` of returns in firing order; bytes written to ``out``, -1 if full."""
    firing = np.zeros(ticks, np.int8)
    mark_firings(starts, tick, shift, ticks, firing)
    coder = start_encoder()
    for t in range(ticks):
        encode_bit(coder, out, firing_model, firing_context(firing, t), firing[t])
    fired = np.flatnonzero(firing)
    _walk(False, coder, out, out, fired, shift, ticks, starts, tick, np.zeros(0, np.uint8), return_model)
    return finish_encoder(coder, out)


@njit(cache=True, nogil=True)
def decode_mask(
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
    coder = start_decoder(data)
    firing = np.zeros(ticks, np.int8)
    for t in range(ticks):
        firing[t] = decode_bit(coder, data, firing_model, firing_context(firing, t))
    fired = np.flatnonzero(firing)
    done = _walk(
        True,
        coder,
        data,
        np.zeros(0, np.uint8),
        fired,
        shift,
        ticks,
        np.zeros(0, np.int64),
        tick,
        laser,
        return_model,
    )
    return laser, tick, done == n and coder[3] == 0
