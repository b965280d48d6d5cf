"""Points of a sensor whose model is known, in any order: laser, tick, count, and what the model is off by.

The lattice's own coder (:mod:`salpcc.stages.predict.static.levels`) wants rings in the order of KITTI's files; this one follows the list. Every point
has a *kind*: on the lattice (AIMED), no return (ZERO, NAN), or OFF it; points off the lattice are coded elsewhere.

* The laser is told from the one at the same place of the firing before (``left`` points back; 0: from the point before).
* The tick goes on as the firing's other ticks, or as those before, did.
* The count is guessed in 1/d from the same laser's last point, from the line along its surface, and from the surfaces seen by the
  lasers next to it in elevation, as far as the list has come there. Surfaces go on from first returns; a second one is guessed from the
  first, and from the laser's last second one.

With an error allowed that is all; else each coordinate is told from the model's as whole units (``per`` a metre, 0: float32 bits).
The decoder repeats all of this, hence only ``+ - * /`` and square roots on float64, in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.residual_bits import CLASSES, code_number, size_of
from salpcc.stages.entropy.walks import code_mixed_bit
from salpcc.stages.lattice.lattice import place_point
from salpcc.stages.lattice.untwist import moved
from salpcc.stages.lists.aimed.aimed_layers import GIVEN, GONE, OWN, code_next, code_role, learn_layer, take
from salpcc.stages.lists.aimed.aimed_neighbours import (
    GUESSES,
    SURFACE,
    above_and_below,
    around,
    guess_inverse,
    learn_distance,
    link,
    link_beside,
    short_way,
)
from salpcc.stages.lists.aimed.aimed_symbols import (
    AIMED,
    FAR,
    HITS,
    NAN,
    NOBODY,
    OFF,
    ZERO,
    code_kind,
    code_laser,
    due_lasers,
    learn_after,
)
from salpcc.stages.lists.learned.learned_counts import code_count
from salpcc.stages.lists.learned.learned_order import code_candidate, code_tick, learn_order
from salpcc.stages.lists.rays.ray_forms import bucket_of, coordinate_of, whole_of

MAX_LEVEL = (1 << 20) - 1
NAN_BITS = 0x7FC00000


class Room(NamedTuple):
    """What a walk over ``S`` points knows of those behind it.

    Attributes:
        slot_laser, relative, slot_size: of each slot its laser (-1: none), its tick from the firing's, the size of the last miss of it.
        hop: ticks from a point of one laser to the next of another ``(L, L)``; 1 << 30: unknown. ``after``, ``pairs``: lasers that came next
            (:func:`~.aimed_symbols.due_lasers`).
        links: of the same laser, point before, point after ``(S, 2)``; ``ends``: of each laser, first and last point so far ``(L, 2)``;
            ``cursor``: where the neighbours above and below were last found ``(L, 2)``.
        second_of: of each laser, its last second return ``(L,)``.
        azimuth, inverse: ticks, 1/d ``(S,)``; ``beside``: 1/d of the surfaces above and below ``(S, 2)``; ``surface``: that of each point ``(S, SURFACE)``.
        errors: of guesses ``(S, GUESSES)``; ``sizes``: of misses of the count, of the corrections, and of the largest of these, up to 3 ``(S, 5)``; ``guess``: of one point.
        drift: of each laser, and of what is no return, last misfit in metres ``(L + 1, 3)``.
    """

    slot_laser: NDArray[np.int64]
    relative: NDArray[np.int64]
    slot_size: NDArray[np.int64]
    hop: NDArray[np.int64]
    after: NDArray[np.int64]
    pairs: NDArray[np.uint8]
    links: NDArray[np.int64]
    ends: NDArray[np.int64]
    cursor: NDArray[np.int64]
    second_of: NDArray[np.int64]
    azimuth: NDArray[np.float64]
    inverse: NDArray[np.float64]
    beside: NDArray[np.float64]
    surface: NDArray[np.float64]
    errors: NDArray[np.uint16]
    sizes: NDArray[np.uint8]
    guess: NDArray[np.float64]
    drift: NDArray[np.float64]


def new_room(n: int, left: int, lasers: int) -> Room:
    """Return what is known before the first of ``n`` points."""
    slots = left if left > 0 else lasers
    return Room(
        np.full(slots, -1),
        np.zeros(slots, np.int64),
        np.zeros(slots, np.int64),
        np.full((lasers, lasers), 1 << 30),
        np.full((lasers, 2), -1),
        np.full((lasers, lasers), NOBODY, np.uint8),
        np.full((n, 2), -1),
        np.full((lasers, 2), -1),
        np.full((lasers, 2), -1),
        np.full(lasers, -1),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 2)),
        np.zeros((n, SURFACE)),
        np.zeros((n, GUESSES), np.uint16),
        np.zeros((n, 5), np.uint8),
        np.zeros(GUESSES),
        np.zeros((lasers + 1, 3)),
    )


@njit(cache=True, error_model="numpy", _nrt=False)
def code_aimed(  # type: ignore[no-untyped-def]
    writing,
    points,
    kinds,
    laser,
    tick,
    level,
    left,
    up,
    form,
    per,
    exact,
    step,
    reach,
    sensor,
    motion,
    models,
    room,
    learned,
    layer,
    state,
    data,
):
    """Write or read ``S`` points: ``points (S, 3)`` float32, kinds, lasers, ticks, levels ``(S,)``.

    Writing, points are overwritten by what a reader will have.

    Args:
        form, per: of corrections, where ``exact``. ``step`` counts make a level.
        reach: 0; above 0 a tick becomes the expected one where that leaves a point within so many metres of ``points``, and what
            is written is no stream.
        sensor: parameters, constants, tables of sines and cosines, count, phase of each laser in ticks, neighbours above and below,
            driver (:data:`~salpcc.stages.lattice.drivers.NO_DRIVER`: none).
        room: of :func:`new_room`.
        learned: models and what they see, of efforts above ``fast``, or None: then lasers, ticks and counts are coded in the two contexts of each.
        layer: what of the list is to be coded, where it has two layers (:mod:`.aimed_layers`).
        motion: whether there is one, its six numbers, s of each point ``(S,)``, and whether what it leaves changes slowly.
    """
    parameters, constants, sines, cosines, count_size, phase, above, below, driver = sensor
    moving, m, place_of, drifting = motion
    of_kind, of_laser, of_tick, of_pace, of_spread, of_level, of_off, of_fix, of_reach = models
    n, ticks, lasers = len(points), len(sines), len(parameters)
    (
        slot_laser,
        relative,
        slot_size,
        hop,
        after,
        pairs,
        links,
        ends,
        cursor,
        second_of,
        azimuth,
        inverse,
        beside,
        surface,
        errors,
        sizes,
        guess,
        drift,
    ) = room
    slots = len(slot_laser)
    base, base_cycle, pace, miss = 0, -1, 0, 0  # of firings: tick, number, ticks from one to the next
    recent, earlier_one, behind = -1, -1, 0
    slot_now, cycle_now = -1, 0
    hits = 0  # whether lasers came when they were due
    layered = len(layer.role) > 0
    follows = left == 0 and (
        learned is None or layered
    )  # lasers follow one another; else what was learned tells
    lag = max(left, up) if max(left, up) > 1 else 0
    for i in range(n):
        slot_now += 1
        if slot_now == slots:
            slot_now, cycle_now = 0, cycle_now + 1
        due = second = -1
        if left > 0:
            due = slot_laser[slot_now]
        elif follows and recent >= 0:
            due, second = due_lasers(after, pairs, laser, recent, earlier_one)
        known = left > 0 and due >= 0
        role = OWN
        if layered and layer.organised:
            role = code_role(writing, state, data, layer, kinds, i, lag)
        elif layered:
            expected = 0
            if left > 0:
                expected = base + relative[slot_now] + pace * (cycle_now - base_cycle)
            elif recent >= 0:
                expected = tick[recent] + (hop[laser[recent], due] if due >= 0 else 0)
            role = code_next(writing, state, data, layer, i, behind, due, expected, ticks)
        if role == GONE:
            kinds[i] = AIMED  # as most points are
            continue
        given = role == GIVEN  # a reader has it
        if given:
            take(layer, behind, i, points, kinds, laser, tick, level)
            behind += 1
        kind = np.int64(kinds[i])
        if not given:
            kind = code_kind(writing, state, data, of_kind, kinds, i, left, up)
        kinds[i] = kind
        if kind == OFF:
            continue
        if kind == NAN or (kind == ZERO and not moving):
            if not writing:
                bits = np.int32(0 if kind == ZERO else NAN_BITS)
                points[i, 0] = points[i, 1] = points[i, 2] = bits.view(np.float32)
            continue
        if state[3] != 0:
            return
        cycle = cycle_now if left > 0 else i
        x = y = z = 0.0
        k, place = 0, -1
        if kind == AIMED:
            before = np.int64(laser[recent]) if recent >= 0 else 0
            k = int(laser[i]) if given else -1
            if learned is not None and left == 0:
                due = second = -1
                if not given:
                    earlier = np.int64(laser[earlier_one]) if earlier_one >= 0 else 0
                    k = code_candidate(
                        writing, state, data, learned.order, learned.heard, i, before, earlier, np.int64(laser[i])
                    )  # fmt: skip
            if k < 0:
                k = code_laser(
                    writing, state, data, of_laser, due, second, -1 if known else before, hits, np.int64(laser[i])
                )  # fmt: skip
            if k >= lasers:
                state[3] = 1
                return
            laser[i] = k
            if due >= 0:
                hits = (hits << 1 | int(k != due)) & (HITS - 1)
            if follows and recent >= 0:
                learn_after(after, pairs, laser, recent, earlier_one, k)
            slot = slot_now if left > 0 else k
            # The tick: as the firing's points before say, or the firings before; or as this pair of lasers did before.
            how, expected = 3, 0
            if left == 0:
                if recent >= 0:
                    how = 0 if hop[laser[recent], k] < 1 << 30 else 2
                    expected = tick[recent] + (hop[laser[recent], k] if how == 0 else 0)
            elif known:
                how = 0 if base_cycle == cycle else 1
                expected = base + relative[slot] + pace * (cycle - base_cycle)
            elif recent >= 0:
                how, expected = 2, tick[recent]
            if reach > 0.0 and how == 0:
                count = level[i] * step + 0.5 * (step - 1)
                x, y, z = place_point(
                    driver, np.int64(expected % ticks), count, k,
                    parameters, constants, count_size, sines, cosines,
                )  # fmt: skip
                if moving:
                    x, y, z = moved(x, y, z, place_of[i], m)
                x -= np.float64(points[i, 0])
                y -= np.float64(points[i, 1])
                z -= np.float64(points[i, 2])
                if x * x + y * y + z * z <= reach * reach:
                    tick[i] = expected % ticks
            off = short_way(tick[i] - expected, ticks)
            if learned is not None and left == 0:
                learn_order(learned.order, learned.heard, i, before, k)
                off = code_tick(
                    given, writing, state, data, learned.order, learned.heard, before, k,
                    expected, how == 0, tick[recent] if recent >= 0 else 0, ticks, off,
                )  # fmt: skip
            elif not given:
                off = code_number(
                    writing, state, data, of_tick, slot_size[slot] * CLASSES + miss,
                    of_pace, how * CLASSES + miss, off,
                )  # fmt: skip
            tick[i] = (expected + off) % ticks
            miss = min(size_of(abs(off)), CLASSES - 1)
            slot_size[slot] = miss
            if left == 0:
                if recent >= 0:
                    hop[laser[recent], k] = short_way(tick[i] - tick[recent], ticks)
            else:
                if base_cycle != cycle:  # the first of its firing tells how far the sensor turned
                    went = short_way(tick[i] - relative[slot] - base, ticks)
                    if base_cycle >= 0 and cycle - base_cycle == 1:
                        pace = went
                    base, base_cycle = base + went, cycle
                relative[slot] = short_way(tick[i] - base, ticks)
                slot_laser[slot] = k
            # The count.
            azimuth[i] = tick[i] + phase[k]
            place = ends[k, 1]
            way = -1
            if learned is not None and learned.shuffled and place >= 0:
                place, way = around(azimuth[i], place, ticks, azimuth, links)
            upper = above_and_below(i, k, above[k], 0, ticks, azimuth, surface, links, ends, cursor, beside)
            lower = above_and_below(i, k, below[k], 1, ticks, azimuth, surface, links, ends, cursor, beside)
            r, spread, apart = guess_inverse(
                i, place, second_of[k], upper, lower, ticks, azimuth, inverse, surface, beside, errors, guess
            )
            unit = count_size * step
            d0 = parameters[k, 4]
            middle = 0.5 * (step - 1)
            if learned is not None:
                scale = d0, unit, middle / step
                level[i] = code_count(
                    given, writing, state, data, learned.counts, learned.counted, i, k, (place, upper, lower), (r, spread, apart), scale,
                    ticks, azimuth, inverse, errors, guess, MAX_LEVEL, level[i],
                )  # fmt: skip
            else:
                foretold = np.int64(
                    np.rint(min(max(((r - d0) / count_size - middle) / step, 0.0), float(MAX_LEVEL)))
                )
                size = np.int64(sizes[place, 0]) if place >= 0 else CLASSES - 1
                number = level[i] - foretold
                if not given:
                    number = code_number(
                        writing, state, data, of_spread, bucket_of(spread, unit),
                        of_level, min(bucket_of(apart, unit) // 2, CLASSES - 1) * CLASSES + size, number,
                    )  # fmt: skip
                sizes[i, 0] = (size_of(abs(number)) + 1) // 2
                level[i] = min(max(foretold + number, 0), MAX_LEVEL)
            count = level[i] * step + middle
            x, y, z = place_point(
                driver, tick[i], count, k, parameters, constants, count_size, sines, cosines
            )
            d = max(count * count_size + d0, 1e-3)
            learn_distance(
                i, place, d, 1.0 / r, ticks, azimuth, inverse, surface, beside, errors, guess
            )  # fmt: skip
            if place >= 0 and azimuth[place] == azimuth[i]:
                second_of[k] = i
            elif way >= 0:
                link_beside(i, k, place, way, links, ends)
            else:
                link(i, k, links, ends)
        if moving:
            x, y, z = moved(x, y, z, place_of[i], m)
        if exact:
            old = recent if place < 0 else place
            same = k if kind == AIMED else lasers
            far = min(bucket_of(np.sqrt(x * x + y * y + z * z), 0.25) // 2, FAR - 1)
            off = np.int64(0)
            if writing or given:
                for c in range(3):
                    model = x if c == 0 else (y if c == 1 else z)
                    whole = whole_of(model + drift[same, c], form, per)
                    off |= np.int64(whole_of(points[i, c], form, per) != whole)
            if not given:
                was = 4 * np.int64(sizes[old, 4]) if old >= 0 else 12
                was += np.int64(sizes[recent, 4]) if recent >= 0 else 3
                off = code_mixed_bit(writing, state, data, of_off, was, of_off, 16 + far, off)
            most = np.int64(0)
            for c in range(3):
                model = x if c == 0 else (y if c == 1 else z)
                whole = whole_of(model + drift[same, c], form, per)
                side = np.int64(sizes[old, 1 + c]) if old >= 0 else CLASSES - 1
                close = np.int64(sizes[recent, 1 + c]) if recent >= 0 else CLASSES - 1
                number = whole_of(points[i, c], form, per) - whole if writing or given else 0
                if off == 1 and not given:
                    number = code_number(
                        writing, state, data, of_fix, (c * CLASSES + side) * CLASSES + close, of_reach, c * FAR + far, number
                    )  # fmt: skip
                sizes[i, 1 + c] = (size_of(abs(number)) + 1) // 2
                most = max(most, np.int64(sizes[i, 1 + c]))
                points[i, c] = coordinate_of(whole + number, form, per)
                if drifting:  # six numbers leave a little of a motion by place, and it changes slowly
                    drift[same, c] = min(max(np.float64(points[i, c]) - model, -1.0), 1.0)
            sizes[i, 4] = min(most, 3)
        else:
            points[i, 0], points[i, 1], points[i, 2] = x, y, z
        if kind == AIMED:
            if layered:
                learn_layer(layer, k, role == OWN)
            earlier_one, recent = recent, i
