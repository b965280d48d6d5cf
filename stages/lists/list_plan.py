"""How a list of points is coded best: on the lattice of its sensor, on rays of told lasers, or along guessed ones.

Inverse: none is needed, as the stream names its form (:mod:`~salpcc.stages.lists.list_coder`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.timed_motion import TimedMotion, find_timed_motion, timed_places
from salpcc.stages.lists.aimed.aimed_layers import GIVEN, OWN, Among
from salpcc.stages.lists.aimed.aimed_points import (
    Motion,
    choose,
)
from salpcc.stages.lists.aimed.aimed_symbols import OFF
from salpcc.stages.lists.aimed.moved_points import write_moved
from salpcc.stages.lists.angled.angled_points import write_angled
from salpcc.stages.lists.learned.learned_lists import Learned
from salpcc.stages.lists.learned.moved_sweep import Clock
from salpcc.stages.lists.list_coder import (
    ANGLED,
    FEWEST,
    MOVED,
    NO_DOUBT,
    TIMED,
    TIMED_AMONG,
    Plan,
    along_rays,
    encode_list,
    form_of,
    off_the_lattice,
    own_line,
    ray_step,
)
from salpcc.stages.lists.rays.ray_coder import F32, Layout
from salpcc.stages.lists.rays.ray_forms import BITS, HALVES
from salpcc.stages.lists.rays.ray_stream import move_points
from salpcc.stages.lists.timed.fit_turning import Fitted
from salpcc.stages.lists.timed.timed_points import write_timed
from salpcc.stages.lists.timeline import Timeline


def plan(
    points: F32,
    max_error: float,
    sensor: SensorModel | None = None,
    motion: Motion = None,
    settled: bool = True,
    lanes: NDArray[np.uint8] | None = None,
    times: NDArray[np.int64] | None = None,
    like: Layout | None = None,
    turning: Fitted | None = None,
    moved_by: TimedMotion | None = None,
    learned: Learned | None = None,
    among: Among | None = None,
) -> Plan:
    """Plan how to encode points ``(S, 3)``.

    Args:
        sensor: whose lattice the points may lie on.
        motion: by place in the list, that moved them off it (:mod:`salpcc.stages.lattice.list_motion`).
        settled: they were snapped, if need be, and no bit may change.
        lanes: the laser of each ``(S,)``, where the sensor tells; a guess will do.
        times: of each ``(S,)``, where they are told.
        like: the layout of the scan before, which exact points are taken to have, too.
        turning: of the scan before; then rays are sought first, and from these.
        moved_by: what moved the scan before, which a search for a motion by time begins with.
        learned: of such points before, for efforts above ``fast``.
        among: where they stand in a list of two layers.
    """
    all_lanes, lanes = lanes, lanes if len(points) >= FEWEST else None
    points = np.ascontiguousarray(points)
    form, per, step = form_of(points, max_error)
    fix = BITS if form == HALVES else form
    exact = settled and step == 0.0
    like = like if exact else None
    among = among if motion is None else None
    beside = among is not None and len(among.given) > 0  # a static layer, which tells more than times

    def rays() -> Plan:
        on_rays = along_rays(points, max_error, settled, lanes, like)
        angled = write_angled(points, off_the_lattice(0.0)) if exact and form == BITS else None
        if angled is not None and on_rays.take_more_than(len(angled)):
            return replace(on_rays, coded=(ANGLED, angled, None))
        if exact and all_lanes is not None and among is not None and beside:
            timed = _timed_among(points, all_lanes, among, form, per, turning, learned)
            if timed is not None and on_rays.take_more_than(len(timed[0])):
                return replace(on_rays, coded=(TIMED_AMONG, *timed[:2]), turning=timed[2])
        if exact and lanes is not None and times is not None:
            timed = write_timed(points, lanes, times, form, per, turning, learned)
            if timed is not None and on_rays.take_more_than(len(timed[0])):
                return replace(on_rays, coded=(TIMED, *timed[:2]), turning=timed[2])
        return on_rays

    if turning is not None and (again := rays()).coded is not None:  # as those of the scan before were
        return again
    moved = None
    if sensor is not None and exact and times is not None:
        moved = partial(_moved_in_time, points, form, fix, per, sensor, lanes, times, like, moved_by, learned)
    if moved is not None and not beside and (found := moved()) is not None:
        return found
    aimed = None
    if sensor is not None:
        whole = points if among is None else among.merged(points)
        chosen = choose(
            whole, fix, per, max_error, sensor, motion, settled, like=like, learned=learned, among=among
        )
        if chosen is not None:
            layout = chosen[0].layout
            aimed = Plan(whole, max_error, layout, fix, per, step, sensor, chosen, lanes, among=among)
    if aimed and (settled or aimed.share >= NO_DOUBT):
        return aimed
    if moved is not None and beside and (found := moved()) is not None:
        return found
    rest = rays()
    return min(aimed, rest, key=_size) if aimed and rest.coded is None else rest


def _timed_among(
    points: F32,
    lanes: NDArray[np.uint8],
    among: Among,
    form: int,
    per: int,
    turning: Fitted | None,
    learned: Learned | None,
) -> tuple[bytes, Timeline, Fitted] | None:
    """Encode points ``(S, 3)`` on the rays of both layers; None where there are none."""
    told = among.timed() if among.timed is not None else None
    if told is None:
        return None
    given = among.role == GIVEN
    laser, time = np.empty(len(given), np.uint8), np.empty(len(given), np.int64)
    laser[given], time[given], time[~given] = told
    laser[~given] = lanes
    found = write_timed(among.merged(points), laser, time, form, per, turning, learned, given)
    return found and (found[0], own_line(found[1], ~given), found[2])


def _moved_in_time(
    points: F32,
    form: int,
    fix: int,
    per: int,
    sensor: SensorModel,
    lanes: NDArray[np.uint8] | None,
    times: NDArray[np.int64],
    like: Layout | None,
    moved_by: TimedMotion | None,
    learned: Learned | None,
) -> Plan | None:
    """Plan for points ``(S, 3)`` that a motion by time moved off the lattice; None where it is not found."""
    found = find_timed_motion(points, sensor, times, lanes, moved_by) if len(points) >= FEWEST else None
    if found is None:
        return None
    motion, reference = found
    s = timed_places(times, reference)
    chosen = choose(points, fix, per, 0.0, sensor, motion, True, s, Clock.of(times), like, learned)
    moved = write_moved(chosen, points, sensor, times, reference, off_the_lattice(0.0)) if chosen else None
    if chosen is None or moved is None:
        return None
    layout = chosen[0].layout
    return Plan(points, 0.0, layout, form, per, 0.0, sensor, chosen, lanes, (MOVED, *moved), moved_by=found)


def snap(
    points: F32,
    max_error: float,
    sensor: SensorModel | None = None,
    motion: Motion = None,
    among: Among | None = None,
) -> F32:
    """Move points ``(S, 3)`` to where the coder will put them, where that keeps the bound; the rest as for :func:`plan`."""
    if ray_step(max_error) == 0.0 or len(points) == 0:
        return points
    return _moved(plan(points, max_error, sensor, motion, settled=False, among=among))


def _moved(found: Plan) -> F32:
    """Return where the points of a plan that is not settled go."""
    if found.chosen is None:
        return move_points(found.points, found.layout, found.form, found.per, found.step, found.max_error)[0]
    moved = found.chosen[1].points.copy()
    off, own = found.chosen[1].kinds == OFF, slice(None)
    if found.among is not None:
        own = found.among.role == OWN
        off &= own
    moved[off] = snap(found.points[off], found.max_error)
    return moved[own]


def _size(found: Plan) -> int:
    """Bytes that the points of a plan that is not settled take once they are moved."""
    points = moved = _moved(found)
    if found.among is not None:
        points = found.among.merged(moved)
    return len(encode_list(np.arange(len(moved)), replace(found, points=points)))
