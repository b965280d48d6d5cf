"""Which firings a scan has, and which of them each laser saw return.

All lasers share the firing ticks up to a constant shift per laser, so a scan is a bitmap of about
2,160 firings in 4,000 ticks and a bitmap of returns per laser. A missing return is a hole in the
scene (sky, glass, a dark car), and holes continue along the ring and from the ring above.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_bit, finish_coder, start_coder, uncounted

FIRING_CONTEXTS = 1 << 6
RETURN_CONTEXTS = 1 << 9

Ticks = NDArray[np.int32]


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


@uncounted
def is_return(writing: bool, tick: Ticks, at: int, end: int, t: int) -> int:
    """Return the bit to write of tick ``t`` of a ring: whether its next return ``at``, before ``end``, is there; 0 when reading."""
    return int(writing and at < end and tick[at] == t)


@uncounted
def note_return(writing: bool, laser: NDArray[np.uint8], tick: Ticks, at: int, k: int, t: int) -> bool:
    """Note, when reading, that return ``at`` is of laser k at tick ``t``; tell whether there was room for it."""
    if writing:
        return True
    if at == len(tick):
        return False
    laser[at] = k
    tick[at] = t
    return True


@njit(cache=True)
def _walk(
    writing: bool,
    starts: NDArray[np.int64],
    tick: Ticks,
    laser: NDArray[np.uint8],
    shift: NDArray[np.int64],
    firing: NDArray[np.int8],
    firing_model: NDArray[np.uint16],
    return_model: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> tuple[int, int]:
    """Code the firings ``(ticks,)``, then the returns of all rings; writing, ``laser`` is not used, reading, ``starts`` are not.

    Returns:
        how many returns there were, -1 for too many; and what :func:`~salpcc.stages.entropy.walks.finish_coder` says.
    """
    state = start_coder(writing, buffer)
    ticks = len(firing)
    for t in range(ticks):
        firing[t] = code_bit(writing, state, buffer, firing_model, firing_context(firing, t), firing[t])
    fired = np.flatnonzero(firing)
    n = len(fired)
    ring_ticks = np.full((3, n + 1), ticks)
    seen = np.zeros((3, n + 4), np.int64)
    done = end = 0
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
        if writing:
            done, end = starts[k], starts[k + 1]
        for f in range(n):
            t = places[f]
            at = follow(at, t, above_places)
            at2 = follow(at2, t, above2_places)
            context = left << 6 | _three(up, at) << 3 | _three(up2, at2)
            bit = is_return(writing, tick, done, end, t)
            bit = code_bit(writing, state, buffer, return_model, context, bit)
            if bit == 1:
                if not note_return(writing, laser, tick, done, k, t):
                    return -1, -1
                done += 1
            here[f + 1] = bit
            left = (left << 1 | bit) & 7
    return done, finish_coder(writing, state, buffer)


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
    unused = np.zeros(0, np.uint8)
    return _walk(True, starts, tick, unused, shift, firing, firing_model, return_model, out)[1]


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
    laser, tick = np.zeros(n, np.uint8), np.zeros(n, np.int32)
    firing, unused = np.zeros(ticks, np.int8), np.zeros(0, np.int64)
    done, rest = _walk(False, unused, tick, laser, shift, firing, firing_model, return_model, data)
    return laser, tick, done == n and rest == 0
