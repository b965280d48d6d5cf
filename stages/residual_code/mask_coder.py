"""Which firings a scan has, and which of them each laser saw return.

All lasers share the firing ticks up to a constant shift per laser, so a scan is a bitmap of about
2,160 firings in 4,000 ticks and a bitmap of returns per laser. A missing return is a hole in the
scene (sky, glass, a dark car), and holes continue along the ring and from the ring above.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.residual_code.range_coder import (
    decode_bit,
    encode_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)

FIRING_CONTEXTS = 1 << 6
RETURN_CONTEXTS = 1 << 9


@njit(cache=True)
def _firing_context(firing: NDArray[np.int8], t: int) -> int:
    """The six ticks before t: firings come every 2 ticks, sometimes 1."""
    context = 0
    for back in range(1, 7):
        context = (context << 1) | (firing[t - back] if t >= back else 0)
    return context


@njit(cache=True)
def _above(state: NDArray[np.int8], t: int, ticks: int) -> int:
    """State of the ring above around tick t: nearest firing at or before, and the two after.

    ``state`` is 0 where nothing fired, 1 fired without return, 2 returned. Returns three bits.
    """
    seen = 0
    u = t
    for _ in range(4):
        if state[u] != 0:
            seen = state[u] >> 1
            break
        u = u - 1 if u > 0 else ticks - 1
    u = t + 1 if t + 1 < ticks else 0
    found = 0
    bits = seen
    for _ in range(8):
        if state[u] != 0:
            bits = (bits << 1) | (state[u] >> 1)
            found += 1
            if found == 2:
                return bits
        u = u + 1 if u + 1 < ticks else 0
    return bits << (2 - found)


@njit(cache=True)
def _return_context(left: int, up: NDArray[np.uint8], up2: NDArray[np.int8], t: int, ticks: int) -> int:
    return (left & 7) << 6 | _above(up, t, ticks) << 3 | _above(up2, t, ticks)


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
    for k in range(len(starts) - 1):
        for i in range(starts[k], starts[k + 1]):
            firing[(tick[i] - shift[k]) % ticks] = 1
    coder = start_encoder()
    for t in range(ticks):
        encode_bit(coder, out, firing_model, _firing_context(firing, t), firing[t])
    up = np.zeros(ticks, np.int8)
    up2 = np.zeros(ticks, np.int8)
    for k in range(len(starts) - 1):
        here = np.zeros(ticks, np.int8)
        i = starts[k]
        left = 7
        for t in range(ticks):
            if firing[(t - shift[k]) % ticks] == 0:
                continue
            bit = 0
            if i < starts[k + 1] and tick[i] == t:
                bit = 1
                i += 1
            encode_bit(coder, out, return_model, _return_context(left, up, up2, t, ticks), bit)
            here[t] = 1 + bit
            left = (left << 1 | bit) & 7
        up2 = up
        up = here
    return finish_encoder(coder, out)


@njit(cache=True)
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
        firing[t] = decode_bit(coder, data, firing_model, _firing_context(firing, t))
    up = np.zeros(ticks, np.int8)
    up2 = np.zeros(ticks, np.int8)
    i = 0
    for k in range(len(shift)):
        here = np.zeros(ticks, np.int8)
        left = 7
        for t in range(ticks):
            if firing[(t - shift[k]) % ticks] == 0:
                continue
            bit = decode_bit(coder, data, return_model, _return_context(left, up, up2, t, ticks))
            here[t] = 1 + bit
            left = (left << 1 | bit) & 7
            if bit == 1:
                if i == n:
                    return laser, tick, False
                laser[i] = k
                tick[i] = t
                i += 1
        up2 = up
        up = here
    return laser, tick, i == n and coder[3] == 0
