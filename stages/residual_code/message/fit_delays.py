"""How late each laser fires in its firing, fitted to the times of points: exact, or next to it, since what is a little off shows at every rounding.

Delays are fitted three times: to the differences of points that follow one another in a list, for these need no firings; then to the firings
that come out; then to the clock of these, which knows of the firings around each.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import ENDLESS
from salpcc.stages.residual_code.message.firing_times import Clocked, Fired, decode_times, encode_times

_GLANCE, _NO_TIMES = 1 << 10, 4.0  # points; bits of each that other fields than times take
_TRIED, _HOPELESS = 1 << 13, 1.5  # points; of the bits a point that are to be beaten, in a trial
_FITTED = 1 << 14  # points
_ROUND = 10**9  # delays are multiples of it, or of a tenth of it, and so on
_ROUNDS = 3
_UNITS = (10**2, 10**3, 10**4)
_FAR = 1 << 61

I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


def find_times(
    fired: Fired, low: I64, high: I64, grain: int, to_beat: int, known: Mask | None = None
) -> tuple[Clocked, bytes] | None:
    """Find how to tell the times ``low ... high (N,)`` of points best, and encode them.

    None where that cannot be, or where trials say that it takes more than the bytes ``to_beat`` by far.

    Args:
        grain: of :class:`~.firing_times.Clocked`.
        known: ``(N,)``, which of the times a reader has.
    """

    n = _enough(fired)
    own, least, most = replace(fired, laser=fired.laser[:n], tick=fired.tick[:n]), low[:n], high[:n]
    there = None if known is None else known[:n]

    def tried(n: int, delay: I64) -> int:
        few = slice(0, n)
        part = replace(own, laser=own.laser[few], tick=own.tick[few])
        some = None if there is None else there[few]
        coded = encode_times(part, least[few], most[few], Clocked(grain, delay), known=some)
        return ENDLESS if coded is None else len(coded) * max(len(low), n) // n

    few = slice(0, _GLANCE)
    delay, _ = _by_pairs(own.laser[few], least[few], most[few], own.lasers)
    size = tried(_GLANCE, delay)
    if 8 * size > _NO_TIMES * len(low) and size > _HOPELESS * to_beat:
        return None
    about, order = _by_pairs(own.laser, least, most, own.lasers)
    firing = _firings(own.laser, least, most, about)
    free = np.full(int(firing.max(initial=0)) + 1, _FAR)
    settled = [
        (_settle(own.laser, least, most, firing, order, about, unit, -free, free.copy()), unit)
        for unit in (_ROUND, 1)
    ]
    size, unit, delay = min((tried(_TRIED, delay), unit, tuple(delay)) for delay, unit in settled)
    if size > _HOPELESS * to_beat:
        return None
    best: tuple[Clocked, int] | None = None
    clocked = Clocked(grain, np.array(delay))
    for _ in range(_ROUNDS):
        coded = encode_times(own, least, most, clocked, ENDLESS if best is None else best[1], there)
        if coded is not None and (best is None or len(coded) < best[1]):
            best = clocked, len(coded)
        clocks = _clocks(own, least, most, clocked, firing, order)
        if clocks is None:
            break
        clocked = Clocked(grain, _settle(own.laser, least, most, firing, order, about, unit, *clocks))
    if best is None:
        return None
    delay = best[0].delay - best[0].delay[order[0]]
    for unit in _UNITS:  # all may be round though some are a little off
        rounded = Clocked(grain, (delay + unit // 2) // unit * unit)
        rounded.delay[-1] = 0
        coded = encode_times(own, least, most, rounded, best[1] - 1, there)
        if coded is not None:
            best = rounded, len(coded)
    whole = encode_times(fired, low, high, best[0], known=known)
    return None if whole is None else (best[0], whole)


def _enough(fired: Fired) -> int:
    """How many of the points, from the first, delays are fitted to: some thousands, or all where a laser would be missing."""
    lasers = fired.laser, fired.laser[:_FITTED]
    of_all, of_some = (np.bincount(laser, minlength=fired.lasers + 1) for laser in lasers)
    return _FITTED if (of_some[of_all > 0] > 0).all() else len(fired.laser)


@njit(cache=True)
def _by_pairs(laser: I64, low: I64, high: I64, lasers: int) -> tuple[I64, I64]:
    """Delays ``(L + 1,)`` by what most points agree on that follow one another: first of the commonest pair of lasers, then of one laser after the other, by its pairs with those before; and the order of these ``(L,)``."""
    own = np.flatnonzero(laser < lasers)
    pair = laser[own[:-1]] * lasers + laser[own[1:]]
    by_pair = np.argsort(pair, kind="mergesort")
    least, most = np.zeros((lasers, lasers), np.int64), np.zeros((lasers, lasers), np.int64)
    agree = np.zeros((lasers, lasers), np.int64)
    start = 0
    while start < len(pair):
        end = start
        while end < len(pair) and pair[by_pair[end]] == pair[by_pair[start]]:
            end += 1
        j, k = pair[by_pair[start]] // lasers, pair[by_pair[start]] % lasers
        if j != k:
            i, h = own[by_pair[start:end]], own[by_pair[start:end] + 1]
            once = np.ones(end - start, np.int64)
            least[j, k], most[j, k], agree[j, k] = _agreed(low[h] - high[i], high[h] - low[i], once)
        start = end
    delay, order = np.zeros(lasers + 1, np.int64), np.zeros(lasers, np.int64)
    best, joined = np.zeros(lasers, np.int64), np.zeros(lasers, np.bool_)
    best[agree.argmax() // lasers] = 1
    starts, ends, weights = np.zeros((3, 2 * lasers), np.int64)
    for n in range(lasers):
        k = int(np.where(joined, -1, best).argmax())
        order[n], joined[k] = k, True
        pairs = 0
        for j in range(lasers):
            for a, b, weight in (
                (delay[j] + least[j, k], delay[j] + most[j, k], agree[j, k]),
                (delay[j] - most[k, j], delay[j] - least[k, j], agree[k, j]),
            ):
                if joined[j] and weight > 0:
                    starts[pairs], ends[pairs], weights[pairs] = a, b, weight
                    pairs += 1
            best[j] = max(best[j], agree[j, k], agree[k, j])
        if pairs > 0:
            a, b, _ = _agreed(starts[:pairs], ends[:pairs], weights[:pairs])
            delay[k] = a + (b - a) // 2
    return delay, order


@njit(cache=True)
def _firings(laser: I64, low: I64, high: I64, delay: I64) -> I64:
    """Number the firings of points ``(N,)`` by roughly known delays; -1 for points of none."""
    firing = np.full(len(laser), -1)
    n, a, b = -1, np.int64(0), np.int64(0)
    for i in range(len(laser)):
        if laser[i] == len(delay) - 1:
            continue
        least, most = low[i] - delay[laser[i]], high[i] - delay[laser[i]]
        if n < 0 or max(a, least) - min(b, most) > b - a + most - least + 2:
            n, a, b = n + 1, least, most
        firing[i] = n
    return firing


@njit(cache=True)
def _settle(
    laser: I64, low: I64, high: I64, firing: I64, order: I64, about: I64, unit: int, first: I64, last: I64
) -> I64:
    """Delays ``(L + 1,)``, multiples of a unit or of the largest tenth of it where such do, of one laser after the other, by the clocks ``first ... last`` of firings ``(F,)``, which they narrow."""
    delay = about.copy()
    by_laser = np.argsort(laser, kind="mergesort")
    starts = np.searchsorted(laser[by_laser], np.arange(len(delay) + 1))
    for k in order:
        own = by_laser[starts[k] : starts[k + 1]]
        by = own[first[firing[own]] > -_FAR]
        if len(by) > 0:
            once = np.ones(len(by), np.int64)
            a, b, _ = _agreed(low[by] - last[firing[by]], high[by] - first[firing[by]], once)
            while unit > 1 and -(-a // unit) * unit > b:
                unit //= 10
            middle = (a + (b - a) // 2 + unit // 2) // unit * unit
            delay[k] = middle if a <= middle <= b else -(-a // unit) * unit
        for i in own:
            a, b = max(first[firing[i]], low[i] - delay[k]), min(last[firing[i]], high[i] - delay[k])
            if a <= b:
                first[firing[i]], last[firing[i]] = a, b
    return delay


def _clocks(
    fired: Fired, low: I64, high: I64, clocked: Clocked, firing: I64, order: I64
) -> tuple[I64, I64] | None:
    """The clocks of firings ``(F,)``, by a walk over the points of that half of the lasers which was settled first; far apart for those without any."""
    there = order[np.bincount(fired.laser, minlength=len(order) + 1)[order] > 0]
    chosen = np.isin(fired.laser, there[: (len(there) + 1) // 2])
    part = replace(fired, laser=np.where(chosen, fired.laser, fired.lasers))
    coded = encode_times(part, low, high, clocked, known=~chosen)
    if coded is None:
        return None
    clock = decode_times(part, clocked, coded, (low, high, ~chosen))[0] - clocked.delay[part.laser]
    first = np.full(int(firing.max(initial=0)) + 1, -_FAR)
    last = -first
    first[firing[chosen]] = last[firing[chosen]] = clock[chosen]
    return first, last


@njit(cache=True)
def _agreed(low: I64, high: I64, weight: I64) -> tuple[int, int, int]:
    """The numbers, from the least to the largest, that intervals of the largest weight hold, and that weight."""
    starts, ends = np.argsort(low, kind="mergesort"), np.argsort(high, kind="mergesort")
    best, depth = np.int64(0), np.int64(0)
    at, until, i, j = low[starts[0]], high[ends[0]], 0, 0
    while i < len(starts):
        if low[starts[i]] <= high[ends[j]]:
            depth += weight[starts[i]]
            if depth > best:
                best, at, until = depth, low[starts[i]], high[ends[j]]
            i += 1
        else:
            depth -= weight[ends[j]]
            j += 1
    return int(at), int(until), int(best)
