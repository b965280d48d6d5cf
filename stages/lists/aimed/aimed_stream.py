"""Points put onto the lattice of a known sensor, and as the bytes of :mod:`.aimed_coder`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import finish_encoder, start_decoder, start_encoder
from salpcc.stages.lattice.aim import Placed, aim
from salpcc.stages.lattice.drivers import NO_DRIVER
from salpcc.stages.lattice.lattice import driven, laser_constants
from salpcc.stages.lattice.list_motion import places, redo, undo
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, turn_tables
from salpcc.stages.lists.aimed.aimed_coder import MAX_LEVEL, NAN_BITS, code_aimed, new_room
from salpcc.stages.lists.aimed.aimed_layers import GIVEN, OWN, Among, Layer, layer, only_layer
from salpcc.stages.lists.aimed.aimed_symbols import AIMED, NAN, OFF, ZERO, new_models
from salpcc.stages.lists.learned.learned_lists import Learned
from salpcc.stages.lists.learned.moved_sweep import Clock, Passing, Turn
from salpcc.stages.lists.rays.ray_coder import F32, Layout
from salpcc.stages.lists.rays.ray_forms import GRID

EXACT_REACH = 0.005  # metres; what is farther from the lattice costs less off it
_ROUNDING = 1e-5  # metres, more than float32 rounds points by
_SLACK = 1e-4  # metres of an allowed error that are left to what the model is off by

_TO_AND_FRO = 0.1

I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Aimed:
    """Points ``(S, 3)`` on a lattice.

    ``points`` are where they decode to without corrections; laser, tick, level are of those of kind AIMED.
    """

    points: F32
    kinds: NDArray[np.uint8]
    laser: NDArray[np.uint8]
    tick: I64
    level: I64

    def some(self, which: slice | NDArray[np.bool_]) -> Aimed:
        """Return a copy of some of the points."""
        return Aimed(*(np.array(column[which]) for column in vars(self).values()))

    @property
    def placed(self) -> Placed:
        """Where the points are that lie on the lattice, of an exact list that nothing moved."""
        return Placed(self.kinds == AIMED, self.laser, self.tick, self.level)


@dataclass(frozen=True, eq=False)
class Way:
    """How points are coded: the layout, form and units of corrections, counts per level, and the ``motion`` that moved them.

    ``s``: of each point ``(S,)`` where times tell it, by the ``clock``; else it follows from the place in the list. ``learned``: of such lists before,
    for efforts above ``fast``; ``shuffled``: then points of a laser are put in the order of their azimuths.
    """

    layout: Layout
    form: int
    per: int
    exact: bool
    step: int
    motion: tuple[float, ...] | None
    s: NDArray[np.float64] | None = None
    clock: Clock | None = None
    learned: Learned | None = None
    shuffled: bool = False

    def places(self, n: int) -> NDArray[np.float64]:
        """Return s of ``n`` points."""
        return places(n, max(self.layout[0], 1)) if self.s is None else self.s


def step_of(max_error: float, sensor: SensorModel) -> int:
    """Counts that a level may span: its middle is at most half of them less a half off."""
    return (
        max(1, int(np.floor(2.0 * (max_error - _SLACK) / sensor.count + 1.0 + 1e-9))) if max_error > 0 else 1
    )


def put(points: F32, sensor: SensorModel, way: Way, reach: float) -> Aimed:
    """Put points ``(S, 3)`` on the lattice where that moves them by ``reach`` metres at most; 0: by no bit. Others are of kind OFF."""
    wide = points.astype(np.float64)
    still = wide
    if way.motion is not None:
        still = undo(wide, way.places(len(points)), np.array(way.motion))
    laser, tick, count, _ = aim(sensor, still)
    level = np.clip(count if way.step == 1 else count // way.step, 0, MAX_LEVEL)
    known = np.maximum(laser, 0).astype(np.uint8)
    model, origin = _decoded(known, tick, level, sensor, way)
    moved, kinds = points.copy(), np.empty(len(points), np.uint8)
    units = float(way.per) if way.form == GRID else 0.0
    _sort(moved, laser, model, origin, way.motion is not None, reach, units, kinds)
    return Aimed(moved, kinds, known, tick, level)


@njit(cache=True, error_model="numpy")
def _near(points: F32, i: int, model: NDArray[np.float64], reach: float) -> bool:
    """Whether point i is within ``reach`` metres of its float32 model point; 0: the same to the bit."""
    far = 0.0
    for c in range(3):
        there = np.float32(model[i, c])
        if reach == 0.0 and np.float32(there).view(np.int32) != np.float32(points[i, c]).view(np.int32):
            return False
        off = np.float64(there) - np.float64(points[i, c])
        far += off * off
    return reach == 0.0 or np.sqrt(far) <= reach


@njit(cache=True, error_model="numpy")
def _within(points: F32, model: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Mark the points ``(S, 3)`` that are :func:`_near` their model points."""
    near = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        near[i] = _near(points, i, model, reach)
    return near


@njit(cache=True, error_model="numpy")
def _sort(  # type: ignore[no-untyped-def]
    points, laser, model, origin, moving, reach, per, kinds
):  # fmt: skip
    """Tell the kinds of points ``(S, 3)`` with lasers (-1: none), and move those on the lattice, and those of no return, to where they decode to; ``per`` as of corrections of form GRID, else 0."""
    for i in range(len(points)):
        kind = AIMED if laser[i] >= 0 and _near(points, i, model, reach) else OFF
        zeros = nans = 0
        whole = True  # what is no whole unit, or is a -0.0, no correction makes
        for c in range(3):
            bits = np.float32(points[i, c]).view(np.int32)
            zeros += bits == 0
            nans += bits == NAN_BITS
            if per > 0.0:
                unit = np.rint(np.float64(points[i, c]) * per) / per + 0.0
                whole &= np.float32(unit).view(np.int32) == bits
        if _near(points, i, origin, reach) if moving else zeros == 3:
            kind = ZERO
        if not whole:
            kind = OFF
        if nans == 3:
            kind = NAN
        kinds[i] = kind
        for c in range(3):
            if kind == AIMED:
                points[i, c] = np.float32(model[i, c])
            elif kind == ZERO and moving:
                points[i, c] = np.float32(origin[i, c])


def is_shuffled(aimed: Aimed, sensor: SensorModel) -> bool:
    """Whether lasers go to and fro: more than a tenth of their points come against the way that most go."""
    on = np.flatnonzero(aimed.kinds == AIMED)
    on = on[np.argsort(aimed.laser[on], kind="stable")]
    ticks = sensor.ticks_per_turn
    went = (np.diff(aimed.tick[on]) + ticks // 2) % ticks - ticks // 2
    went = went[(np.diff(aimed.laser[on].astype(np.int64)) == 0) & (went != 0)]
    back = np.count_nonzero(went < 0)
    return bool(min(back, len(went) - back) > _TO_AND_FRO * len(went))


def settle(
    aimed: Aimed, points: F32, sensor: SensorModel, way: Way, max_error: float, among: Among | None = None
) -> Aimed:
    """Turn ticks to where the coder expects them, as far as points ``(S, 3)`` stay within ``max_error``.

    All points but those of kind OFF will be found again at the same places by a :func:`put` that moves no bit.
    """
    eased = replace(aimed.some(slice(None)), points=points.copy())
    scratch = np.empty(64 * len(points) + 4096, np.uint8)
    part = None if among is None else _layer(among, aimed.some(among.role == GIVEN))
    _code(True, eased.points, eased, sensor, way, max_error - _ROUNDING, start_encoder(), scratch, part)
    if among is not None:
        eased = replace(eased, kinds=np.where(among.role == OWN, eased.kinds, aimed.kinds))
    on = eased.kinds == AIMED
    model, _ = _decoded(eased.laser, eased.tick, eased.level, sensor, way)
    moved = np.where(on[:, None], model.astype(np.float32), aimed.points)
    again = put(moved, sensor, way, 0.0)
    lost = (eased.kinds != OFF) & ((again.kinds != eased.kinds) | (on & ~_within(points, model, max_error)))
    kinds = np.where(lost, OFF, eased.kinds).astype(np.uint8)
    return replace(again, points=np.where(lost[:, None], points, moved), kinds=kinds)


def _decoded(
    laser: NDArray[np.uint8], tick: I64, level: I64, sensor: SensorModel, way: Way
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where places on the lattice decode to, ``(S, 3)``, and where no return would."""
    middle = (level * way.step + 0.5 * (way.step - 1)).astype(np.float64)
    model = driven(sensor, laser, tick.astype(np.int32), middle)
    if way.motion is None:
        return model, np.zeros((0, 3))
    origin = np.zeros(model.shape)
    s, motion = way.places(len(laser)), np.array(way.motion)
    return redo(model, s, motion), redo(origin, s, motion)


def write_aimed(
    aimed: Aimed,
    points: F32,
    sensor: SensorModel,
    way: Way,
    out: NDArray[np.uint8],
    among: Among | None = None,
) -> int:
    """Write ``points`` whose lattice places are ``aimed``; return the bytes written to ``out``.

    -1: ``out`` is full, or a reader would have other points.

    Args:
        among: which of the points are written, where a reader has others, or none.
    """
    state = start_encoder()
    told = points.copy()
    walked, part = aimed, None
    if among is not None:
        walked, part = aimed.some(slice(None)), _layer(among, aimed.some(among.role == GIVEN))
    _code(True, told, walked, sensor, way, 0.0, state, out, part)
    if ((told.view(np.int32) != points.view(np.int32)) & (aimed.kinds != OFF)[:, None]).any():
        return -1
    return int(finish_encoder(state, out))


def read_aimed(
    n: int, sensor: SensorModel, way: Way, data: NDArray[np.uint8], among: Among | None = None
) -> tuple[Aimed, bool]:
    """Inverse of :func:`write_aimed`: ``n`` points, and whether the data made sense; those of kind OFF are zeros.

    Args:
        among: in which those that are not GIVEN get their roles.
    """
    empty, part = no_points(n), None
    if among is not None:
        part = _layer(among, put(among.given, sensor, way, EXACT_REACH if way.exact else 0.0))
    state = start_decoder(data)
    _code(False, empty.points, empty, sensor, way, 0.0, state, data, part)
    return empty, bool(state[3] == 0)


def no_points(n: int) -> Aimed:
    """Return ``n`` points of which nothing is known yet."""
    return Aimed(
        np.zeros((n, 3), np.float32),
        np.zeros(n, np.uint8),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
    )


def _layer(among: Among, known: Aimed) -> Layer:
    """Return what a walk takes along of a layer; ``known``: where the points that are GIVEN lie."""
    return layer(among, known.kinds, known.laser, known.tick, known.level)


def _code(
    writing: bool,
    points: F32,
    aimed: Aimed,
    sensor: SensorModel,
    way: Way,
    reach: float,
    state: I64,
    data: NDArray[np.uint8],
    part: Layer | None = None,
) -> None:
    motion = False, (0.0,) * 6, np.zeros(1), False
    if way.motion is not None:
        motion = True, way.motion, way.places(len(points)), way.s is None  # type: ignore[assignment]
    room = new_room(len(points), way.layout[0], sensor.n_lasers)
    learned = None
    if way.learned is not None and reach == 0.0:
        passing = None
        if way.clock is not None and way.motion is not None:
            known = aimed.kinds, aimed.laser, aimed.tick, aimed.level
            passing = Passing(*known, np.array(way.motion), way.clock)
        own = Turn(room.azimuth, room.inverse, room.links, room.ends, np.zeros(0, np.int64))
        learned = way.learned.walk(own, passing, sensor, way.shuffled)
    code_aimed(
        writing, points, aimed.kinds, aimed.laser, aimed.tick, aimed.level, *way.layout, way.form, float(way.per), way.exact,
        way.step, reach, _tables(sensor), motion, new_models(), room, learned,
        part or only_layer(), state, data,
    )  # fmt: skip


@lru_cache(maxsize=4)
def _tables(sensor: SensorModel) -> tuple[Any, ...]:
    """What :func:`code_aimed` wants of a sensor; neighbours in elevation are -1 where there is none."""
    parameters = np.ascontiguousarray(sensor.parameters)
    order = np.argsort(-sensor.theta, kind="stable")
    above, below = np.full(len(order), -1), np.full(len(order), -1)
    above[order[1:]], below[order[:-1]] = order[:-1], order[1:]
    phase = parameters[:, 3] * (sensor.ticks_per_turn / TWO_PI)
    sines, cosines = turn_tables(sensor.ticks_per_turn)
    driver = NO_DRIVER if sensor.driver is None else sensor.driver.tables
    return parameters, laser_constants(parameters), sines, cosines, sensor.count, phase, above, below, driver
