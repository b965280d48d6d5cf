"""Lasers and times of a list of points, told from each other: every laser fires again after one more turn of its sensor's firings.

A *group* of lasers is one sensor; a list may hold the points of several in the order of their times. Of every laser that was seen, the time at
which it is due is known: when it last was, and one *cycle* later for every return that was missing since. The laser of the next point is that which is due
first, or else the next after it; what differs from the time that it was due at, such as a packet's new stamp, is true of its whole group.

Stream: lasers of a sensor (uint8, 0: all are of one), number of groups (uint8), first time (int64), the cycle of each group (uint32), the walk.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import ENDLESS, room_for
from salpcc.stages.entropy.range_coder import finish_encoder, new_bits, start_decoder, start_encoder
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number
from salpcc.stages.entropy.walks import code_mixed_bit, code_mixed_tree

LASERS = 256
_NEVER = np.int64(1) << 62
_LARGEST = np.int64(1) << 39
_LONGEST = 1 << 32
_MOST_SKIPPED = 64  # on the way to a laser; to go on from there is cheaper
_REMEMBERED = 3  # times that a laser was due
_STEADY = 15  # points of a group since its times last were not those that they were due at
_SIZES = (0, 16, 32, 64, 128)  # lasers of a sensor
_NEARLY = 1.1  # of the shortest; then rays tell which lasers are of one sensor
_HEAD = struct.Struct("<BBq")

I64 = NDArray[np.int64]
Lasers = NDArray[np.uint8]
Given = NDArray[np.bool_] | None


class Passed(NamedTuple):
    """The number of a list in its group, from 1 on, and where its points were in the list before ``(N,)``; -1: nowhere."""

    number: int
    there: I64


@dataclass(frozen=True, eq=False)
class Timeline:
    """Lasers ``(N,)`` and times ``(N,)``, whole numbers, of points in the order of a list; ``groups``: lasers of a sensor, 0 for all.

    ``passed``: where these points were in the list before, for efforts above ``fast``.
    """

    laser: Lasers
    time: I64
    groups: int
    passed: Passed | None = None

    @property
    def group(self) -> I64:
        """The sensor ``(LASERS,)`` of each laser."""
        return np.arange(LASERS) // self.groups if self.groups else np.zeros(LASERS, np.int64)


@njit(cache=True)
def _next(due: NDArray[np.int64], seen: int, asked: NDArray[np.int64], floor: int) -> int:
    """The laser that is due first of those that were not asked; the lower number first."""
    best = -1
    for k in range(seen):
        if due[k] != _NEVER and asked[k] != floor and (best < 0 or due[k] < due[best]):
            best = k
    return best


@njit(cache=True)
def _skips(due: NDArray[np.int64], seen: int, laser: int) -> int:
    """Lasers that are due before a laser."""
    skips = 0
    for k in range(seen):
        if due[k] < due[laser] or (due[k] == due[laser] and k < laser):
            skips += 1
    return skips


@njit(cache=True)
def _not_come(missed: int, turns: int) -> int:
    """What was ``missed`` of a laser, after more turns in which it did not come."""
    return (missed + 1 << min(turns, _REMEMBERED)) - 1


@njit(cache=True)
def _pass(k, time, g, cycle, due, late, missed, steady):  # type: ignore[no-untyped-def]
    """Take note of a given point of laser k and group g; the others of its group learn of it by :func:`_catch_up`."""
    if due[k] != _NEVER:
        off = time - due[k] - late[g]
        turns = (off + cycle // 2) // cycle
        if turns > 0:
            missed[k] = _not_come(missed[k], turns)
        off -= turns * cycle
        late[g] += off
        steady[g] = steady[g] + 1 if off == 0 else 0
    due[k] = time + cycle - late[g]
    missed[k] = missed[k] << 1


@njit(cache=True)
def _catch_up(seen, now, group, cycle, due, late, missed):  # type: ignore[no-untyped-def]
    """Let lasers be due as far as given points have shown: those that are due before ``now`` did not come."""
    for k in range(seen):
        if due[k] == _NEVER:
            continue
        g = group[k]
        due[k] += late[g]
        if due[k] < now:
            turns = (now - due[k] + cycle[g] - 1) // cycle[g]
            due[k] += turns * cycle[g]
            missed[k] = _not_come(missed[k], turns)
    late[:] = 0


@njit(cache=True)
def _code(writing, laser, time, given, group, cycle, models, state, data):  # type: ignore[no-untyped-def]
    """Write or read lasers and times ``(N,)``, but those that are ``given (N,)``; ``cycle``: of each group."""
    of_way, of_laser, of_seen, of_own, of_off = models
    due = np.full(LASERS, _NEVER)
    asked = np.full(LASERS, -1)  # the last point before which a laser was asked for and did not come
    missed = np.zeros(LASERS, np.int64)  # of each laser, whether it did of the last times that it was due
    steady = np.zeros(LASERS, np.int64)
    late = np.zeros(LASERS, np.int64)  # of each group, what given points differed from when they were due
    passed = False
    skipped = np.empty(LASERS, np.int64)
    now, odd, before, total = np.int64(0), np.int64(0), np.int64(0), 0
    seen = 0  # above the highest laser that came; no other is due
    n = len(laser)
    for i in range(n):
        k = np.int64(laser[i])
        if given[i]:
            now, before, passed = time[i], k, True
            seen = max(seen, int(k) + 1)
            _pass(k, now, group[k], cycle[group[k]], due, late, missed, steady)
            continue
        if passed:
            _catch_up(seen, now, group, cycle, due, late, missed)
            passed = False
        way = np.int64(0)
        if writing:
            way = np.int64(
                due[k] == _NEVER
                or _skips(due, seen, k) > _MOST_SKIPPED
                or abs(time[i] - due[k]) > cycle[group[k]] // 2
            )
        way = code_mixed_bit(writing, state, data, of_way, odd, of_way, odd, way)
        odd = (odd << 1 | way) & 255
        if way == 1:
            row = before * 256
            k = np.int64(code_mixed_tree(writing, state, data, of_laser, row, of_laser, row, 8, k))
            off = time[i] - now
            if writing and abs(off) >= _LARGEST:
                state[3] = 1
                return
            now += code_number(
                writing, state, data, of_off, 2 * (_STEADY + 1), of_off, 2 * (_STEADY + 1), off
            )
            g = group[k]
            for other in range(seen):  # those of its group that were due long ago
                if due[other] != _NEVER and group[other] == g and due[other] < now - cycle[g] // 2:
                    due[other] += (now - cycle[g] // 2 - due[other] + cycle[g] - 1) // cycle[g] * cycle[g]
            steady[g] = 0
        else:
            found, n_skipped = -1, 0
            while True:
                found = _next(due, seen, asked, i)
                if found < 0 or total > 64 * (n + 64):
                    state[3] = 1
                    return
                tied = 0 if due[found] != now else (1 if asked[found] == i - 1 else 2)
                at = ((missed[found] & 7) * 3 + tied) * 2 + np.int64(n_skipped > 0)
                own = found * 8 + (missed[found] & 1) * 4 + tied
                if code_mixed_bit(writing, state, data, of_seen, at, of_own, own, np.int64(found != k)) == 0:
                    break
                asked[found] = i
                skipped[n_skipped] = found
                n_skipped += 1
                total += 1
            k = np.int64(found)
            g = group[k]
            told = np.int64(min(steady[g], np.int64(_STEADY)))
            off = code_number(
                writing, state, data, of_off, told, of_off, _STEADY + 1 + told, time[i] - due[k]
            )
            now = due[k] + off
            for j in range(n_skipped):
                other = skipped[j]
                if due[other] < due[k]:
                    due[other] += cycle[group[other]]
                    missed[other] = missed[other] << 1 | 1
            if off != 0:
                for other in range(seen):
                    if due[other] != _NEVER and group[other] == g:
                        due[other] += off
                steady[g] = 0
            else:
                steady[g] += 1
        if state[3] != 0:
            return
        if not writing:
            laser[i], time[i] = k, now
        if k >= seen:
            seen = int(k) + 1
        due[k] = now + cycle[g]
        missed[k] = missed[k] << 1
        asked[k] = -1
        before = k


def find_timelines(laser: Lasers, time: I64, given: Given = None) -> list[tuple[Timeline, bytes]]:
    """Return the timelines that points of lasers ``(N,)`` at times ``(N,)`` may have, with their streams, the shortest first, those nearly as short after it; none where times say nothing of lasers.

    Args:
        given: which ``(N,)`` a reader has; None: none.
    """
    found: list[tuple[Timeline, bytes]] = []
    for size in _SIZES:
        if size and laser.max(initial=0) < size:
            continue
        line = Timeline(laser, time, size)
        to_beat = int(_NEARLY * min((len(told) for _, told in found), default=ENDLESS))
        coded = encode_timeline(line, to_beat, given)
        if coded is not None:
            found.append((line, coded))
    found.sort(key=lambda one: len(one[1]))
    return [(line, told) for line, told in found if len(told) <= _NEARLY * len(found[0][1])]


def _cycles(line: Timeline) -> I64 | None:
    """The most usual time from return to return of a laser, of each group; None where a laser has none."""
    group = line.group[line.laser]
    cycles = np.zeros(int(group.max()) + 1, np.int64)
    for g in range(len(cycles)):
        own = np.flatnonzero(group == g)
        own = own[np.argsort(line.laser[own], kind="stable")]
        steps = np.diff(line.time[own])[np.diff(line.laser[own].astype(np.int64)) == 0]
        values, counts = np.unique(steps[steps > 0], return_counts=True)
        if not len(values) or values[counts.argmax()] >= _LONGEST:
            return None
        cycles[g] = values[counts.argmax()]
    return cycles


def encode_timeline(line: Timeline, to_beat: int = ENDLESS, given: Given = None) -> bytes | None:
    """Encode lasers and times, but those that are ``given (N,)``; None where times do not go round, or take many more than the bytes ``to_beat``."""
    cycles = _cycles(line) if len(line.laser) else None
    if cycles is None:
        return None
    origin = int(line.time[0])
    out = room_for(32 * len(line.laser) + 4096, to_beat)
    state = start_encoder()
    known = np.zeros(len(line.laser), np.bool_) if given is None else given
    _code(True, line.laser, line.time - origin, known, line.group, cycles, _models(), state, out)
    written = int(finish_encoder(state, out)) if state[3] == 0 else -1
    head = _HEAD.pack(line.groups, len(cycles), origin) + cycles.astype("<u4").tobytes()
    return head + out[:written].tobytes() if written >= 0 else None


def decode_timeline(
    n: int, data: bytes, given: tuple[NDArray[np.bool_], Lasers, I64] | None = None
) -> tuple[Timeline, bool]:
    """Inverse of :func:`encode_timeline`: ``n`` points, and whether the data made sense; ``given``: which ``(n,)`` are known, their lasers and times."""
    line, known = Timeline(np.zeros(n, np.uint8), np.zeros(n, np.int64), 0), np.zeros(n, np.bool_)
    if given is not None:
        known = given[0]
        line.laser[known], line.time[known] = given[1:]
    if len(data) < _HEAD.size:
        return line, False
    groups, n_cycles, origin = _HEAD.unpack_from(data)
    line = Timeline(line.laser, line.time, groups)
    begin = _HEAD.size + 4 * n_cycles
    if groups not in _SIZES or len(data) < begin or n_cycles < 1:
        return line, False
    cycles = np.zeros(LASERS, np.int64) + 1
    cycles[:n_cycles] = np.frombuffer(data, "<u4", n_cycles, _HEAD.size)
    raw = np.frombuffer(bytearray(data[begin:]), np.uint8)
    state = start_decoder(raw)
    line.time[known] -= origin
    _code(False, line.laser, line.time, known, line.group, np.maximum(cycles, 1), _models(), state, raw)
    line.time[:] += origin
    return line, bool(state[3] == 0)


def _models() -> tuple[NDArray[np.uint16], ...]:
    return (
        new_bits(256), new_bits(256 * 256), new_bits(8 * 3 * 2), new_bits(LASERS * 8),
        new_bits((2 * _STEADY + 3) * PER_CONTEXT),
    )  # fmt: skip
