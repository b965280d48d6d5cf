"""Times of points, from the laser and the firing: a clock that goes on from firing to firing, and each laser's delay behind it.

Values are whole numbers (:class:`.number_forms.Spans`), often several that mean the same: the time of a point is ``clock + delay[laser]``,
rounded to what was recorded, so the clock is finer than what shows of it; the writer picks one that suits the firings to come, and then next to nothing is to be said of it.

Whether the clock goes on is told in the context of what speaks for it: a laser that fires no later than the one before, that comes back, a tick far from that of
the firing's first point. It most often goes on by one of the last few steps.

Of a movable layer the times of both layers' points are walked over. Those of the static one are known, and points are most often of the firing of the next of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

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
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number, size_of
from salpcc.stages.entropy.walks import code_mixed_bit, code_raw
from salpcc.stages.lattice.sensor_model import SensorModel

MOST_GRAIN = 16
_LARGEST = (1 << 39) - 1  # difference that a number holds
_CLOCK_BITS = 64
_STEPS = 6  # of the clock from firing to firing that are remembered
_AHEAD = 1 << 10  # points that a clock is to suit
_TURNS, _APART = 7, 12  # turns of the lasers in a firing, sizes of differences in ticks that are told apart
# Where contexts begin: of a point between known ones of one clock, of several; that may be of the clock of the next known one; of steps. First those of others.
_SEEN = 3 * (_TURNS + 2)
_BETWEEN = _SEEN * _APART
_AMONG = _BETWEEN + 4
_SHARES = _AMONG + 3 * _SEEN
_STEPPED = _SHARES + 3
_STEP_BITS = (_STEPS + 1) * _STEPS

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

    @cached_property
    def phase(self) -> I64:
        """Tick of the common firing of each point ``(N,)``."""
        return (self.tick - self.shift[self.laser]) % self.ticks


ON_LATTICE = 0.01  # metres; with an error allowed points are half a level off


def fired_by(sensor: SensorModel, laser: I64, tick: I64, count: I64, off: F64) -> Fired:
    """Return when and by which lasers points ``(N,)`` were measured, from what :func:`~salpcc.stages.lattice.aim.aim` says of them."""
    lasers = np.where((laser >= 0) & (off < ON_LATTICE), laser, sensor.n_lasers)
    return Fired(lasers, tick, np.append(sensor.shift, 0), sensor.ticks_per_turn)


@dataclass(frozen=True, eq=False)
class Clocked:
    """How times follow from firings.

    Attributes:
        grain: binary places in which steps of the clock are most often even.
        delay: of each laser ``(L + 1,)``, 0 for none.
    """

    grain: int
    delay: I64


class _Given(NamedTuple):
    """Lasers of points, their delays, the times that would do, of which a reader has those that are known."""

    laser: I64
    delay: I64
    low: I64
    high: I64
    known: Mask


@njit(cache=True)
def _suits(given: _Given, i: int, clock: int) -> bool:
    """Whether the time of point i follows from a clock."""
    return bool(given.low[i] <= clock + given.delay[given.laser[i]] <= given.high[i])


@njit(cache=True)
def _lasting(given: _Given, i: int, steps: I64, only: bool) -> tuple[int, int]:
    """The clocks, from the least to the largest, that suit point i, and as many after it as any if they go on by these steps; ``only`` those that are known."""
    laser, delay, low, high, known = given
    a, b = low[i] - delay[laser[i]], high[i] - delay[laser[i]]
    gone = np.int64(0)
    for j in range(i + 1, min(i + _AHEAD, len(laser))):
        if laser[j] == len(delay) - 1 or (only and not known[j]):
            continue
        least, most = low[j] - delay[laser[j]] - gone, high[j] - delay[laser[j]] - gone
        step, c = np.int64(0), 0
        while max(a, least - step) > min(b, most - step) and c < len(steps):
            step = steps[c]
            c += 1
        if max(a, least - step) > min(b, most - step):
            break
        a, b, gone = max(a, least - step), min(b, most - step), gone + step
    return a, b


@njit(cache=True)
def _next(
    given: _Given, i: int, clock: int, steps: I64, last: int, told: int, grain: int, only: bool
) -> tuple[int, int]:
    """The step by which the clock comes to suit point i, _STEPS for a new one, and what it is then."""
    a, b = _lasting(given, i, steps[:0], only)
    if last < _STEPS and a <= clock + steps[last] <= b:
        return last, clock + steps[last]
    for c in range(_STEPS):
        if a <= clock + steps[c] <= b:
            return c, clock + steps[c]
    a, b = _lasting(given, i, steps, only)
    middle, origin = a + (b - a) // 2, clock + told
    even = ((middle - origin + (1 << grain >> 1)) >> grain << grain) + origin
    return _STEPS, even if a <= even <= b else middle


@njit(cache=True)
def _order(one: int, other: int) -> int:
    """Which of two numbers is larger."""
    return 0 if other > one else 1 if other == one else 2


@njit(cache=True)
def _code(writing, state, data, given, phase, ticks, grain, times, bits, numbers):  # type: ignore[no-untyped-def]
    """Write or read the times ``(N,)`` of points.

    Args:
        phase: tick of the common firing of each point.
    """
    laser, delay, low, high, known = given
    nobody = len(delay) - 1
    clock, value, told = np.int64(0), np.int64(0), np.int64(0)
    began, span = np.int64(0), np.int64(0)  # of the steps since the last new one, and of those before
    steps, used, last = np.zeros(_STEPS, np.int64), np.zeros(_STEPS, np.int64), _STEPS
    fired, before = np.full(nobody + 1, -1), nobody
    turn, turned, first = 0, 0, np.int64(0)
    coming = 0  # the next known point
    for i in range(len(laser)):
        k = laser[i]
        if k == nobody:
            if known[i]:
                value = low[i]
            else:
                off = min(max(value, low[i]), high[i]) - value
                if writing and abs(off) > _LARGEST:
                    state[3] = 1
                    return
                value += code_number(writing, state, data, numbers, 2, numbers, 2, off)
            times[i] = value
            continue
        back = fired[k] == turn and k != before
        stays, at, shares = False, i, known[i]
        if before != nobody and known[i]:
            stays = _suits(given, i, clock)
        elif before != nobody:
            coming = max(coming, i)
            while coming < len(laser) and not (known[coming] and laser[coming] != nobody):
                coming += 1
            order = _order(delay[before], delay[k])
            near = coming < len(laser)
            alike = near and _suits(given, coming, clock)
            seen = 3 * (min(turn - turned, _TURNS) + 1) * int(back) + order
            if alike:
                spot = _BETWEEN + min(seen, 3)
            elif near:
                spot = _AMONG + 3 * seen + _order(delay[k], delay[laser[coming]])
            else:
                apart = abs(phase[i] - first)
                spot = seen * _APART + min(size_of(min(apart, ticks - apart)), _APART - 1)
            leaves = np.int64(writing and not _suits(given, i, clock))
            stays = code_mixed_bit(writing, state, data, bits, spot, bits, spot, leaves) == 0
            if not stays and near and not alike:
                at, spot = coming, _SHARES + order
                goal = _next(given, at, clock, steps, last, told, grain, True)[1]
                joins = np.int64(writing and _suits(given, i, goal))
                shares = code_mixed_bit(writing, state, data, bits, spot, bits, spot, joins) != 0
        if before == nobody:
            a, b = _lasting(given, i, steps, known[i]) if writing or known[i] else (clock, clock)
            goal = a + (b - a) // 2
            if known[i]:
                clock = goal
            else:
                for part in range(0, _CLOCK_BITS, 16):
                    clock |= code_raw(writing, state, data, 16, (goal >> part) & 0xFFFF) << part
        elif not stays:
            c, goal = _STEPS, clock
            if writing or shares:
                c, goal = _next(given, at if shares else i, clock, steps, last, told, grain, shares)
            if not shares:
                due = 1 + int(abs(clock - began) >= span)
                wanted, c = c, 0
                while c < _STEPS:
                    spot = _STEPPED + last * _STEPS + c
                    also = spot + due * _STEP_BITS
                    if (
                        code_mixed_bit(writing, state, data, bits, spot, bits, also, np.int64(wanted != c))
                        == 0
                    ):
                        break
                    c += 1
                off = goal - clock - told
                if c < _STEPS:
                    goal = clock + steps[c]
                elif writing and abs(off) > _LARGEST:
                    state[3] = 1
                    return
                else:
                    rest = off & ((1 << grain) - 1)
                    rest = code_number(writing, state, data, numbers, 1, numbers, 1, rest)
                    off = code_number(writing, state, data, numbers, 0, numbers, 0, off >> grain)
                    goal = clock + told + (off << grain) + rest
            last = c
            if c == _STEPS:
                c = int(used.argmin())
                steps[c] = told = goal - clock
                span, began = abs(clock - began), goal
            used[c] = i
            clock = goal
        if state[3] != 0:
            return
        if not stays or back:
            turn += 1
        if not stays:
            turned, first = turn, phase[i]
        fired[k] = turn
        before = k
        value = clock + delay[k]
        times[i] = value


def encode_times(
    fired: Fired, low: I64, high: I64, clocked: Clocked, to_beat: int = ENDLESS, known: Mask | None = None
) -> bytes | None:
    """Encode times between ``low`` and ``high`` ``(N,)``; None where that cannot be, or takes more than the bytes ``to_beat``.

    Args:
        known: ``(N,)``, which of them a reader has.
    """
    out = room_for(16 * len(low) + 4096, to_beat)
    state = start_encoder()
    known = np.zeros(len(low), np.bool_) if known is None else known
    times = np.zeros(len(low), np.int64)
    given = _Given(fired.laser, clocked.delay, low, high, known)
    _code(True, state, out, given, fired.phase, fired.ticks, clocked.grain, times, *_models())
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
    times = np.zeros(len(fired.laser), np.int64)
    low, high, known = given or (times, times, np.zeros(len(times), np.bool_))
    of = _Given(fired.laser, clocked.delay, low, high, known)
    _code(False, state, raw, of, fired.phase, fired.ticks, clocked.grain, times, *_models())
    return times, bool(state[3] == 0)


def _models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(_STEPPED + 3 * _STEP_BITS), new_bits(3 * PER_CONTEXT)
