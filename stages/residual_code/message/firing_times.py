"""Times of points, from the laser and the firing: a clock that goes on from firing to firing, and each laser's delay behind it.

Values are whole numbers (:class:`.number_forms.Spans`), often several that mean the same: the time of a point is ``clock + delay[laser]``,
rounded to what was recorded, so the clock is finer than what shows of it; the writer picks one that goes on evenly, and then next to nothing is to be said of it.

Of a movable layer the times of both layers' points are walked over. Those of the static one are known, so the clock of a firing that has such a point is, too.

A firing begins where a laser comes back, or where a point's tick, less the laser's own shift, is no longer that of the firing before.
The clock then most often goes on by one of the last few steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import ENDLESS, as_array, room_for, within
from salpcc.stages.entropy.range_coder import (
    finish_encoder,
    new_bits,
    start_decoder,
    start_encoder,
)
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number
from salpcc.stages.entropy.walks import code_mixed_bit, code_raw
from salpcc.stages.lattice.sensor_model import SensorModel

_ROUNDS = 6
_LARGEST = (1 << 39) - 1  # difference that a number holds
_CLOCK_BITS = 64
_SAME = (0.3, 2.0, 1e9)  # of the ticks from firing to firing; the last: only lasers tell firings
_TRIED, _FITTED, _FINALISTS = 1 << 13, 1 << 15, 2  # points, ways of telling
_GLANCE, _NO_TIMES = 1 << 10, 4.0  # points; bits of each that other fields than times take
_NEAR = 1.1  # of the shortest trial; others are no finalists
_HOPELESS = 1.5  # of the bits a point that are to be beaten, in a trial
_COUNTED = 8  # times as far apart as there are
_STEPS = 6  # of the clock from firing to firing that are remembered

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Fired:
    """What a time is predicted from.

    Attributes:
        laser: of each point ``(N,)``; the number of lasers where there is none.
        tick: of each point ``(N,)``.
        shift: of each laser ``(L + 1,)`` against the common firing, in ticks, roughly.
        ticks: in a turn.
    """

    laser: I64
    tick: I64
    shift: I64
    ticks: int

    @property
    def lasers(self) -> int:
        """Lasers of the sensor."""
        return len(self.shift) - 1


ON_LATTICE = 0.01  # metres; with an error allowed points are half a level off


def fired_by(sensor: SensorModel, laser: I64, tick: I64, count: I64, off: F64) -> Fired:
    """Return when and by which lasers points ``(N,)`` were measured, from what :func:`~salpcc.stages.lattice.aim.aim` says of them."""
    lasers = np.where((laser >= 0) & (off < ON_LATTICE), laser, sensor.n_lasers)
    return Fired(lasers, tick, np.append(sensor.shift, 0), sensor.ticks_per_turn)


@dataclass(frozen=True, eq=False)
class Clocked:
    """How times follow from firings.

    Attributes:
        shifted: lasers have shifts.
        apart: ticks that points of one firing differ by at most.
        delay: of each laser ``(L + 1,)``, 0 for none.
    """

    shifted: bool
    apart: int
    delay: I64


@njit(cache=True)
def _begins(laser: I64, phase: I64, ticks: int, apart: int, nobody: int) -> NDArray[np.bool_]:
    """Mark the first point ``(N,)`` of every firing."""
    begins = np.zeros(len(laser), np.bool_)
    fired = np.full(nobody + 1, -1)
    firing, first, before = 0, np.int64(-1), np.int64(-1)
    for i in range(len(laser)):
        k = laser[i]
        if k == nobody:
            continue
        off = (phase[i] - first) % ticks
        if first < 0 or min(off, ticks - off) > apart or (fired[k] == firing and k != before):
            begins[i] = True
            first = phase[i]
            firing += 1
        fired[k] = firing
        before = k
    return begins


@njit(cache=True)
def _suits(
    i: int, begins: Mask, low: I64, high: I64, laser: I64, delay: I64, known: Mask, only: bool
) -> tuple[int, int]:
    """The clocks that suit point i and as many of its firing after it as any; ``only`` those that are known, the first of them if i is none."""
    while only and not known[i]:
        i += 1
    a, b = low[i] - delay[laser[i]], high[i] - delay[laser[i]]
    j = i + 1
    while j < len(laser) and not begins[j]:
        if known[j] or not only:
            first, last = max(a, low[j] - delay[laser[j]]), min(b, high[j] - delay[laser[j]])
            if first > last:
                break
            a, b = first, last
        j += 1
    return a, b


@njit(cache=True)
def _has_known(i: int, begins: Mask, known: Mask) -> bool:
    """Whether a point of the firing that begins at point i is known."""
    while not known[i]:
        i += 1
        if i == len(known) or begins[i]:
            return False
    return True


@njit(cache=True)
def _code(writing, state, data, laser, delay, begins, low, high, known, clocks, bits, numbers):  # type: ignore[no-untyped-def]
    """Write or read the clocks ``(N,)`` of points; ``low``, ``high``: the times that would do, of which a reader has those that are ``known (N,)``."""
    clock = np.int64(0)
    steps, used = np.zeros(_STEPS, np.int64), np.zeros(_STEPS, np.int64)
    recent, last = 0, _STEPS
    for i in range(len(laser)):
        before = clock
        starts = i == 0 or begins[i]
        told = _has_known(i, begins, known) if starts else known[i]  # and the clock with it
        sees = writing or told
        a, b = np.int64(0), np.int64(0)
        if starts and sees:
            a, b = _suits(i, begins, low, high, laser, delay, known, told)
        if i == 0 and told:
            clock = a + (b - a) // 2
        elif i == 0:
            for part in range(_CLOCK_BITS // 16):
                clock |= code_raw(writing, state, data, 16, ((a + (b - a) // 2) >> (16 * part)) & 0xFFFF) << (
                    16 * part
                )
        elif starts:
            which = _STEPS
            if sees:
                for c in range(_STEPS - 1, -1, -1):
                    if a <= clock + steps[c] <= b:
                        which = c
                if last < _STEPS and a <= clock + steps[last] <= b and which == _STEPS:
                    which = last
            c = 0
            while c < _STEPS:
                at = 8 + last * _STEPS + c
                other = np.int64(which != c)
                if not told:
                    other = code_mixed_bit(writing, state, data, bits, at, bits, at, other)
                if other == 0:
                    break
                c += 1
            if c == _STEPS:
                wanted = clock + steps[recent]
                off = min(max(wanted, a), b) - wanted
                if not told:
                    off = code_number(writing, state, data, numbers, 0, numbers, 0, off)
                clock = wanted + off
                c = int(used.argmin())
                steps[c] = clock - before
                last = _STEPS
            else:
                clock += steps[c]
                last = c
            used[c] = i
            recent = c
        if known[i] and not low[i] <= clock + delay[laser[i]] <= high[i]:
            a, b = _suits(i, begins, low, high, laser, delay, known, True)
            clock = min(max(clock, a), b)
        elif not known[i] and (told or not starts):
            changes = writing and not low[i] <= clock + delay[laser[i]] <= high[i]
            at = 0 if i < 2 or clocks[i - 1] == clocks[i - 2] else 1
            if code_mixed_bit(writing, state, data, bits, at, bits, at, np.int64(changes)) != 0:
                if writing:
                    a, b = _suits(i, begins, low, high, laser, delay, known, False)
                clock += code_number(
                    writing, state, data, numbers, 1, numbers, 1, min(max(clock, a), b) - clock
                )
        if state[3] != 0:
            return
        if (writing or known[i]) and abs(clock - before) > _LARGEST and i > 0:
            state[3] = 1
            return
        clocks[i] = clock


@njit(cache=True)
def _delays(laser: I64, begins: NDArray[np.bool_], low: I64, high: I64, lasers: int) -> I64:
    """Fit the delay of each laser ``(L + 1,)``, about that of the first to fire."""
    n = len(laser)
    delay = np.zeros(lasers + 1, np.int64)
    by_laser = np.argsort(laser, kind="mergesort")
    firing = np.cumsum(begins.astype(np.int64))
    clock = np.zeros(firing[-1] + 1, np.int64)
    before = np.empty_like(delay)
    for round_ in range(_ROUNDS):
        before[:] = delay
        # The clock of a firing: where its intervals meet, or between.
        start = 0
        while start < n:
            end = start
            a, b = np.int64(-1) << 62, np.int64(1) << 62
            while end < n and firing[end] == firing[start]:
                if laser[end] < lasers:
                    a = max(a, low[end] - delay[laser[end]])
                    b = min(b, high[end] - delay[laser[end]])
                end += 1
            clock[firing[start]] = (low[start] if round_ == 0 else a) // 2 + (
                high[start] if round_ == 0 else b
            ) // 2
            start = end
        # The delay of a laser: what most of its points agree on.
        start = 0
        while start < n:
            end = start
            k = laser[by_laser[start]]
            while end < n and laser[by_laser[end]] == k:
                end += 1
            if k < lasers:
                own = by_laser[start:end]
                delay[k] = _agreed(low[own] - clock[firing[own]], high[own] - clock[firing[own]])
            start = end
        if round_ > 0 and (delay == before).all():  # and so in all rounds to come
            break
    return delay


@njit(cache=True)
def _sorted(values: I64) -> I64:
    """The same numbers ``(N,)`` in their order: most often they are so near to one another that they can be counted."""
    low = values.min()
    apart = values.max() - low
    if not 0 <= apart < _COUNTED * len(values):
        return np.sort(values)
    counts = np.zeros(apart + 1, np.int64)
    for value in values:
        counts[value - low] += 1
    found, at = np.empty_like(values), 0
    for k in range(len(counts)):
        for _ in range(counts[k]):
            found[at] = low + k
            at += 1
    return found


@njit(cache=True)
def _agreed(low: I64, high: I64) -> int:
    """The number that most of the intervals hold, the middle of where they do."""
    starts, ends = _sorted(low), _sorted(high)
    best, depth, at, i, j = 0, 0, starts[0], 0, 0
    until = ends[0]
    while i < len(starts):
        if starts[i] <= ends[j]:
            depth += 1
            if depth > best:
                best, at, until = depth, starts[i], ends[j]
            i += 1
        else:
            depth -= 1
            j += 1
    return at + (until - at) // 2


def find_times(
    fired: Fired, low: I64, high: I64, to_beat: int, known: Mask | None = None
) -> tuple[Clocked, bytes] | None:
    """Find how to tell the times ``low ... high (N,)`` of points best, and encode them.

    None where that cannot be, or where trials say that it takes more than the bytes ``to_beat`` by far.

    Args:
        known: ``(N,)``, which of the times a reader has.
    """
    more = _first(fired, _FITTED)
    fitted = slice(0, _FITTED)
    at_first = _tried(fired, low, high, known, _GLANCE)
    least = min((size for size, _ in at_first), default=ENDLESS) / min(_GLANCE, len(low))
    if 8.0 * least > _NO_TIMES and least * len(low) > _HOPELESS * to_beat:
        return None
    tried = _tried(fired, low, high, known, _TRIED)
    best: tuple[Clocked, bytes] | None = None
    tried.sort(key=lambda found: found[0])
    if not tried or tried[0][0] * len(low) > _HOPELESS * to_beat * min(_TRIED, len(low)):
        return None
    for size, early in tried[:_FINALISTS]:
        if size > _NEAR * tried[0][0]:
            break
        # Early times are rounded least.
        for clocked in (early, _fitted(early, more, low[fitted], high[fitted])):
            coded = encode_times(fired, low, high, clocked, ENDLESS if best is None else len(best[1]), known)
            if coded is not None and (best is None or len(coded) < len(best[1])):
                best = clocked, coded
    return best


def _tried(fired: Fired, low: I64, high: I64, known: Mask | None, n: int) -> list[tuple[int, Clocked]]:
    """The ways to tell times, fitted to the first ``n`` points, and the bytes that these take."""
    few, part = _first(fired, n), slice(0, n)
    tried = []
    for shifted in (True, False) if fired.shift.any() else (False,):
        phase = _phase(few, shifted)[few.laser < few.lasers]
        steps = np.abs((np.diff(phase) + fired.ticks // 2) % fired.ticks - fired.ticks // 2)
        pace = float(np.median(steps[steps > steps.mean()])) if (steps > steps.mean()).any() else 0.0
        for same in _SAME:
            clocked = _fitted(
                Clocked(shifted, int(min(same * pace, fired.ticks)), fired.shift), few, low[part], high[part]
            )
            coded = encode_times(
                few, low[part], high[part], clocked, known=None if known is None else known[part]
            )
            if coded is not None:
                tried.append((len(coded), clocked))
    return tried


def _first(fired: Fired, n: int) -> Fired:
    return replace(fired, laser=fired.laser[:n], tick=fired.tick[:n])


def _fitted(clocked: Clocked, fired: Fired, low: I64, high: I64) -> Clocked:
    """The same with the delays of these points."""
    return replace(clocked, delay=_delays(fired.laser, _of(fired, clocked), low, high, fired.lasers))


def _phase(fired: Fired, shifted: bool) -> I64:
    """Tick of the common firing of each point ``(N,)``."""
    return (fired.tick - fired.shift[fired.laser] * int(shifted)) % fired.ticks


def _of(fired: Fired, clocked: Clocked) -> NDArray[np.bool_]:
    return np.asarray(
        _begins(
            fired.laser, _phase(fired, clocked.shifted), fired.ticks, clocked.apart, len(clocked.delay) - 1
        )
    )


def encode_times(
    fired: Fired, low: I64, high: I64, clocked: Clocked, to_beat: int = ENDLESS, known: Mask | None = None
) -> bytes | None:
    """Encode times between ``low`` and ``high`` ``(N,)``; None where that cannot be, or takes more than the bytes ``to_beat``.

    Args:
        known: ``(N,)``, which of them a reader has.
    """
    out = room_for(12 * len(low) + 4096, to_beat)
    state = start_encoder()
    clocks = np.zeros(len(low), np.int64)
    known = np.zeros(len(low), np.bool_) if known is None else known
    begins = _of(fired, clocked)
    _code(True, state, out, fired.laser, clocked.delay, begins, low, high, known, clocks, *_models())
    times = clocks + clocked.delay[fired.laser]
    if state[3] != 0 or (((times < low) | (times > high)) & ~known).any():
        return None
    return within(out, int(finish_encoder(state, out)), to_beat)


def decode_times(
    fired: Fired, clocked: Clocked, data: bytes, given: tuple[I64, I64, Mask] | None = None
) -> tuple[I64, bool]:
    """Inverse of :func:`encode_times`: the times ``(N,)`` as whole numbers, and whether the data made sense.

    Args:
        given: the least and the largest times ``(N,)`` that would do, and which of them are known.
    """
    raw = as_array(data)
    state = start_decoder(raw)
    clocks = np.zeros(len(fired.laser), np.int64)
    low, high, known = given or (clocks, clocks, np.zeros(len(clocks), np.bool_))
    begins = _of(fired, clocked)
    _code(False, state, raw, fired.laser, clocked.delay, begins, low, high, known, clocks, *_models())
    return clocks + clocked.delay[fired.laser], bool(state[3] == 0)


def _models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(8 + (_STEPS + 1) * _STEPS), new_bits(2 * PER_CONTEXT)
