"""Find a sensor's driver near its fitted model: which formula, and every laser's own float32 numbers, by counting identical bits.

A float32 sine of the elevation gives back every z of its laser or else about half of them, so the one that most points agree on
is the driver's. The azimuth offset is sought likewise, among all float32 angles that whole indices leave.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import aim, given_back
from salpcc.stages.lattice.drivers import FORMULAS, HESAI, SINES, STEPS, TURNING, Driver, bearing_of, ouster
from salpcc.stages.lattice.drivers.sines import cosine32, sine32
from salpcc.stages.lattice.sensor_model import SensorModel, with_driver

_LEVER = 1e-4  # metres; formulas know no lever arms
_NEAR = 0.1  # metres; nearer points tell nothing
_SAMPLE, _REFINED = 500, 10_000  # points of a laser
_CHOSEN, _FEW = 3, 150  # lasers that the formula is chosen by, and points of them
_HALF, _HOLDS, _SURE = 0.5, 0.9, 0.99  # of the points of a laser
_WIDEST, _ASIDE = 2000, 1200  # indices that an offset may be, of any sensor and of one whose type is known
_WINDOW = 2.5e-7  # radians that the phase of azimuths may be off by
_TRIED = 200  # offsets in that window
_ULPS = 4
_FEWER = 60  # points of a laser
MORE = 1.3  # times the lasers that a cloud shows, that its sensor may have
_TURNED = 18  # hundredths of a degree
_NEAREST_ORIGIN, _FARTHEST_ORIGIN = 5_000, 40_000  # micrometres from the axis that Ouster's beams start
_ORIGIN_OFF = 10  # micrometres that cones leave unsure
_HEIGHTS, _NEAR_HEIGHT = (36_180.0, 38_195.0), 30.0  # of their data sheets

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def find_driver(model: SensorModel, points: F32, laser: I64) -> SensorModel | None:
    """Return the model with the driver that made points ``(N, 3)`` of lasers ``(N,)`` (-1: not known), the likeliest one where it is not sure; None where there is none."""
    levers = np.abs(np.stack([model.h, model.z0, model.d0]))
    if np.median(levers, axis=1).max() > _LEVER:  # of a laser with few points there may be any
        points, laser = _few_of_each(points, laser, model.n_lasers)
        found = max(_ouster(model), key=lambda tried: given_back(tried, points, laser).sum())
        return _polished(found, points, laser)
    reach = np.sqrt((points.astype(np.float64) ** 2).sum(axis=1))
    own = _by_laser(laser, reach, model.n_lasers)
    few = [own[k][:_FEW] for k in sorted(range(model.n_lasers), key=lambda k: -len(own[k]))[:_CHOSEN]]
    best: tuple[float, Driver] | None = None
    for single in (False, True):
        d = _ranges(reach, model.count, single)
        if np.median([_elevation(points[some, 2], d[some])[1] for some in few]) < _HOLDS:
            continue
        for formula, sine in ((formula, sine) for formula in TURNING for sine in SINES):
            share = float(
                np.median(
                    [
                        _laser(points[some], d[some], formula, SINES.index(sine), _WIDEST, _HOLDS)[1]
                        for some in few
                    ]
                )
            )
            if best is None or share > best[0]:
                best = share, Driver(formula, sine, single, np.zeros((0, 4), np.float32))
            if share > _SURE:
                break
    if best is None or best[0] < _HOLDS:
        return _in_float64(model)
    kind = best[1]
    d = _ranges(reach, model.count, kind.single)
    rows = [_laser(points[some], d[some], kind.formula, SINES.index(kind.sine))[0] for some in own]
    return with_driver(model, replace(kind, lasers=np.array(rows, np.float32)))


def find_unit(model: SensorModel, points: F32, ring: I64 | None = None) -> SensorModel | None:
    """Return the model of another unit of a sensor, whose lasers look elsewhere by less than half of what is between them; None where points ``(N, 3)`` are of none.

    Formula, counts and order are those of ``model``; every laser's own numbers are found again, or kept where it has too few points.

    Args:
        ring: of each point ``(N,)``, where it is told: then a point is of the laser that most of its ring are nearest to.
    """
    kind = model.driver
    if kind is None or kind.formula not in TURNING:
        return None
    wide = points.astype(np.float64)
    laser = aim(model, wide)[0]
    if ring is not None:
        laser = _of_rings(ring, laser, model.n_lasers)
    reach = np.sqrt((wide**2).sum(axis=1))
    own = _by_laser(laser, reach, model.n_lasers)
    d = _ranges(np.nan_to_num(reach, posinf=0.0), model.count, kind.single)
    sine, rows = SINES.index(kind.sine), kind.lasers.copy()
    known = [k for k in sorted(range(model.n_lasers), key=lambda k: -len(own[k])) if len(own[k]) >= _FEWER]
    if MORE * len(known) < model.n_lasers:
        return None  # of another sensor, some of whose lasers look nearly where these do
    few = [own[k][:_FEWER] for k in known[:_CHOSEN]]
    shares = [_laser(points[some], d[some], kind.formula, sine, _ASIDE, _HOLDS)[1] for some in few]
    if len(shares) < _CHOSEN or np.median(shares) < _HOLDS:
        return None
    for k in known:
        row, share = _laser(points[own[k]], d[own[k]], kind.formula, sine, _ASIDE)
        if share > _HALF:
            rows[k] = row
    found = with_driver(model, replace(kind, lasers=rows))
    return replace(found, shift=model.shift, bit_identical_share=round(share_identical(found, points), 6))


def _by_laser(laser: I64, reach: F64, lasers: int) -> list[I64]:
    """Return which points ``(N,)`` are of each laser, in no order; those next to the sensor are left out."""
    order = np.random.default_rng(0).permutation(np.flatnonzero((laser >= 0) & (reach > _NEAR)))
    return [order[laser[order] == k] for k in range(lasers)]


def _of_rings(ring: I64, laser: I64, lasers: int) -> I64:
    """The laser ``(N,)`` that most points of each one's ring are nearest to; as it was where two rings would be of one laser."""
    seen = laser >= 0
    most = np.zeros((int(ring.max(initial=0)) + 1, lasers), np.int64)
    np.add.at(most, (ring[seen], laser[seen]), 1)
    of_ring = most.argmax(axis=1)
    known = most.any(axis=1)
    if len(np.unique(of_ring[known])) < known.sum():
        return laser
    return np.where(seen, of_ring[ring], -1)


def _few_of_each(points: F32, laser: I64, lasers: int) -> tuple[F32, I64]:
    """Some of the points ``(N, 3)`` of each laser, and their lasers."""
    order = np.random.default_rng(0).permutation(np.flatnonzero(laser >= 0))
    own = np.concatenate([order[laser[order] == k][:_FEWER] for k in range(lasers)])
    return points[own], laser[own]


def _polished(model: SensorModel, points: F32, laser: I64) -> SensorModel:
    """Turn each laser to where most of its points come back bit for bit: by hundredths of a degree, then as any other laser, or nearly."""
    assert model.driver is not None
    seen = np.maximum(np.bincount(laser, minlength=model.n_lasers), 1)
    best, rows = np.full(model.n_lasers, -1.0), model.driver.lasers.copy()
    hundredths = 10.0 * np.array(sorted(range(-_TURNED, _TURNED + 1), key=abs))  # as millidegrees
    for again in (False, True):
        others = np.unique(rows[:, 1])[:, None] + hundredths[:3]
        for aside in np.unique(others) if again else hundredths:
            tried = model.driver.lasers.copy()
            tried[:, 1] = aside if again else tried[:, 1] + aside
            trial = with_driver(model, replace(model.driver, lasers=tried))
            share = np.bincount(laser, given_back(trial, points, laser), model.n_lasers) / seen
            rows[share > best] = tried[share > best]
            best = np.maximum(best, share)
    return with_driver(model, replace(model.driver, lasers=rows))


def _ouster(model: SensorModel) -> list[SensorModel]:
    """The model with Ouster's formula, whose numbers are round, and origins of beams as far from the axis as cones leave possible; for the caller to try."""
    tangent = np.tan(model.theta)
    beside = np.arange(_NEAREST_ORIGIN, _FARTHEST_ORIGIN)  # micrometres
    along = np.sqrt(np.maximum((beside[:, None] * ouster.MICROMETRES) ** 2 - model.h**2, 0.0))
    height = model.z0 + along * tangent
    middle = np.median(height, axis=1)
    best = int(np.median(np.abs(height - middle[:, None]), axis=1).argmin())
    n, t = float(beside[best]), float(np.rint(middle[best] / ouster.MICROMETRES))
    t = next((height for height in _HEIGHTS if abs(height - t) < _NEAR_HEIGHT), t)
    step = 2 * np.pi / model.ticks_per_turn
    roughly = -np.arcsin(np.clip(model.h / (n * ouster.MICROMETRES), -1.0, 1.0))
    azimuth = model.phi0 - np.pi
    azimuth += step * np.rint((roughly - azimuth) / step)
    tens = [np.rint(np.degrees(angle) * 100.0) * 10.0 for angle in (model.theta, -azimuth)]
    tried = []
    for origin in range(int(n) - _ORIGIN_OFF, int(n) + _ORIGIN_OFF + 1):
        rows = np.stack([*tens, np.full(model.n_lasers, origin), np.full(model.n_lasers, t)], axis=1)
        kind = Driver("ouster", "rounded", False, rows.astype(np.float32), model.ticks_per_turn)
        tried.append(with_driver(model, kind))
    return tried


def _in_float64(model: SensorModel) -> SensorModel:
    """The model with angles in whole millidegrees and nothing rounded before the end, which is Ouster's formula with beams from the axis; for the caller to try."""
    angles = [np.rint(np.degrees(angle) * 1000.0) for angle in (model.theta, np.pi - model.phi0)]
    rows = np.stack([*angles, *np.zeros((2, model.n_lasers))], axis=1).astype(np.float32)
    return with_driver(model, Driver("ouster", "rounded", False, rows, model.ticks_per_turn))


def _ranges(reach: F64, unit: float, single: bool) -> F32:
    """The ranges of a driver, from distances ``(N,)``."""
    counts = np.rint(reach / unit)
    return np.asarray(
        counts.astype(np.float32) * np.float32(unit) if single else (counts * unit).astype(np.float32)
    )


def share_identical(model: SensorModel, points: F32) -> float:
    """Share of the returns among points ``(N, 3)`` that the model gives back bit for bit."""
    with np.errstate(invalid="ignore"):
        returns = points[np.abs(points).max(axis=1, initial=0.0) > 0]
    return float(given_back(model, returns).sum() / max(len(returns), 1))


def _laser(
    points: F32, d: F32, formula: str, sine: int, widest: int = _WIDEST, least: float = 0.0
) -> tuple[tuple[float, ...], float]:
    """Return the row of one laser, and the share of its points ``(N, 3)`` at ranges ``(N,)`` that it gives back; ``widest``: indices that its offset may be.

    Rows that give back less than the share ``least`` are not told from one another.
    """
    if not len(points):
        return (1.0, 0.0, *FORMULAS[formula].row(sine, np.float32(0.0))), 0.0
    sin_e, _ = _elevation(points[:, 2], d)
    cosines = _cosines(sin_e)
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    ways = {
        "velodyne": (-y, x),
        "hesai": (x, y),
        "pandar": (y, -x),
        "nebula": (-y, x),
        "pandar_degrees": (y, -x),
    }
    turns = np.arctan2(*ways[formula]) / (2 * np.pi) * STEPS
    phase = float(np.angle(np.exp(2j * np.pi * turns).mean()) / (2 * np.pi))
    part = slice(0, _REFINED)
    widest = 0 if formula == "nebula" else widest  # whose indices have the offset in them
    number = list(FORMULAS).index(formula)
    values = FORMULAS[formula].table(sine)
    lost, offset, cos_e = _search(
        number,
        sine,
        values,
        points[part],
        d[part],
        turns[part],
        phase,
        cosines,
        _SAMPLE,
        widest,
        _TRIED,
        least,
    )
    share = 1.0 - lost / len(points[part])
    return (cos_e, sin_e, *FORMULAS[formula].row(sine, np.float32(offset))), share


def _elevation(z: F32, d: F32) -> tuple[np.float32, float]:
    """Return the float32 sine that gives back most heights ``(N,)`` at ranges ``(N,)``, and the share of them."""
    wide, half = z.astype(np.float64), np.spacing(np.abs(z)).astype(np.float64) / 2
    ends = np.concatenate([(wide - half) / d, (wide + half) / d])
    order = np.argsort(ends, kind="stable")
    depth = np.cumsum(np.where(order < len(z), 1, -1))
    at = int(depth.argmax())
    middle = np.float32((ends[order[at]] + ends[order[min(at + 1, len(order) - 1)]]) / 2)
    near = np.append(_around(middle, _ULPS), np.float32(0.0))
    hits = [(d * sine == z).mean() for sine in near]
    return near[int(np.argmax(hits))], float(np.max(hits))


def _cosines(sin_e: np.float32) -> F32:
    """Cosines that a float32 elevation of that sine may have."""
    angles = _around(np.float32(np.arcsin(np.float64(sin_e))), 40)
    told = [cosine32(kind, a) for kind in (0, 1) for a in angles if sine32(kind, a) == sin_e]
    return np.unique(np.array(told or _around(np.float32(np.sqrt(1.0 - float(sin_e) ** 2)), 1), np.float32))


def _around(value: np.float32, ulps: int) -> F32:
    bits = np.array([value], np.float32).view(np.int32)
    return np.asarray((bits + np.arange(-ulps, ulps + 1, dtype=np.int32)).view(np.float32))


@njit(cache=True, error_model="numpy")
def _search(formula, sine, values, points, d, turns, phase, cosines, few, widest, tried, least):  # type: ignore[no-untyped-def]
    """Return the fewest points lost, and the offset and cosine that lose them; offsets of few indices come first."""
    few = min(few, len(points))
    best, best_offset, best_cosine = np.int64((1.0 - least) * few) + 1, np.float32(0.0), cosines[0]
    index = np.empty(len(points), np.int64)
    unit = 2.0 * np.pi / len(values)
    step = 2.0 * _WINDOW / tried
    for round_ in range(2 * widest + 1):
        n = (round_ + 1) // 2 * (1 if round_ & 1 else -1)
        for i in range(few):
            index[i] = np.int64(np.rint(turns[i] - phase - n)) % len(values)
        middle = (phase + n) * unit
        for t in range(tried + 2):
            offset = np.float32(middle - _WINDOW + t * step)
            if t == tried + 1:
                if abs(middle) > _WINDOW:
                    continue
                offset = np.float32(0.0)
            for cos_e in cosines:
                lost = _lost(formula, sine, values, points[:few], d, index, offset, cos_e, best)
                if lost < best:
                    best, best_offset, best_cosine = lost, offset, cos_e
        if best == 0:
            break
    # Small offsets are finer than the steps so far, and more points tell more of them.
    n = np.rint(best_offset / unit - phase)
    for i in range(len(points)):
        index[i] = np.int64(np.rint(turns[i] - phase - n)) % len(values)
    centre = np.float64(best_offset)
    best = _lost(formula, sine, values, points, d, index, best_offset, best_cosine, len(points) + 1)
    for t in range(-2 * tried, 2 * tried + 1):
        offset = np.float32(centre + t * step * 4 / tried)
        lost = _lost(formula, sine, values, points, d, index, offset, best_cosine, best)
        if lost < best:
            best, best_offset = lost, offset
    sign = 1.0 if formula == HESAI else -1.0
    return best, sign * best_offset, best_cosine


@njit(cache=True, error_model="numpy")
def _lost(formula, sine, values, points, d, index, offset, cos_e, most):  # type: ignore[no-untyped-def]
    """Points whose x and y do not come back; counted no further than ``most``."""
    a, b = offset, np.float32(0.0)
    if formula != HESAI:
        a, b = cosine32(sine, -offset), sine32(sine, -offset)
    lost = 0
    for i in range(len(points)):
        u, v = bearing_of(formula, sine, values, index[i], a, b)
        rho = np.float32(d[i] * cos_e)
        if np.float32(rho * u) != points[i, 0] or np.float32(rho * v) != points[i, 1]:
            lost += 1
            if lost >= most:
                return lost
    return lost
