"""Motion of clouds that list firing after firing: found, undone and done again.

Such clouds are often published as seen from where the sensor stood at one moment. Like KITTI's (:mod:`.untwist`) a point q became
``R(s w) q + s v``, but s follows from its place in the list: of C firings the last has s = 0, the first ``(C - 1) / C``.
So v has the sign that KITTI's has: a point moves ahead by -v in a turn.

What to measure by is the sensor itself: cones tell all of the motion but the yaw, then whole range counts tell v to a tenth of a
millimetre, and whole ticks tell the yaw. Nothing is rounded here, so unlike KITTI's this motion is not exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import aim
from salpcc.stages.lattice.find_lasers import Listed, find_firing
from salpcc.stages.lattice.find_steps import find_count
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.untwist import moved, turned_back

TICKS = (512, 1024, 2048, 4096, 3600, 4000, 7200, 18_000, 36_000)  # of sensors whose clouds are published so
_NEAREST = 3.0  # metres
_SAMPLE = 6000  # points
_ENOUGH = 100  # points of a laser that tell counts
_SECTOR = 0.02  # turns that the counts are unwrapped from, ever more by
_WIDER, _IN_SECTOR = 1.3, 4000  # points
_PADDED = 1 << 15
_LASERS = 32  # that tell the yaw, at most
_LINE = 0.3
_ON_LATTICE = 0.003  # metres
_WORTH_IT = 0.05  # of the points that come onto it
_ANOTHER = 1e-3  # slope that cones of another sensor, or of another reference, are off by; a sensor's own are off by 1e-5
FASTEST = 0.2  # radians a turn; the sensor's own turning would pass for yaw

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Solved:
    """The motion ``(6,)`` of a scan, and the steps that it was found by."""

    motion: F64
    ticks: int
    count: float


@dataclass(frozen=True, eq=False)
class Cones:
    """Slope and apex height of each laser, ``(L,)``."""

    slope: F64
    height: F64


def places(n: int, firing: int) -> F64:
    """Return s of ``n`` points in firings of so many."""
    firings = max(-(-n // firing), 1)
    return np.asarray((firings - 1 - np.arange(n) // firing) / firings)


@njit(cache=True, error_model="numpy")
def undo(points: F64, s: F64, motion: F64) -> F64:
    """Undo the motion ``(6,)`` of points ``(N, 3)`` at places ``(N,)``."""
    out = np.empty((len(points), 3))
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = turned_back(points[i, 0], points[i, 1], points[i, 2], s[i], m)
    return out


@njit(cache=True, error_model="numpy")
def redo(points: F64, s: F64, motion: F64) -> F64:
    """Inverse of :func:`undo`."""
    out = np.empty((len(points), 3))
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = moved(points[i, 0], points[i, 1], points[i, 2], s[i], m)
    return out


def fit_cones(points: F64, laser: I64, lasers: int) -> tuple[Cones, F64]:
    """Return the cones of points ``(N, 3)`` of lasers ``(N,)``, and how far each point is above or below its own."""
    rho = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    slope, height, off = _cones(rho, np.ascontiguousarray(points[:, 2]), *_grouped(laser, lasers))
    return Cones(slope, height), off


def _grouped(laser: I64, lasers: int) -> tuple[I64, I64]:
    """The points of each laser one after the other, and where those of each begin, ``(L + 1,)``; others are left out."""
    order = np.argsort(laser, kind="stable")
    return order, np.searchsorted(laser[order], np.arange(lasers + 1))


@njit(cache=True, error_model="numpy")
def _line(x: F64, y: F64, rows: I64, near: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and height of the line through the near ones of these rows; sums in their order, so the same on every machine."""
    n, mean_x, mean_y = 0, 0.0, 0.0
    for j in range(len(rows)):
        if near[j]:
            n += 1
            mean_x += x[rows[j]]
            mean_y += y[rows[j]]
    if n == 0:
        return 0.0, 0.0
    mean_x /= n
    mean_y /= n
    along, across = 0.0, 0.0
    for j in range(len(rows)):
        if near[j]:
            d = x[rows[j]] - mean_x
            along += d * d
            across += d * (y[rows[j]] - mean_y)
    slope = across / along if along > 0.0 else 0.0
    return slope, mean_y - slope * mean_x


@njit(cache=True, error_model="numpy")
def _cones(rho: F64, z: F64, order: I64, starts: I64) -> tuple[F64, F64, F64]:
    lasers = len(starts) - 1
    slope, height = np.zeros(lasers), np.zeros(lasers)
    off = np.full(len(rho), np.inf)
    for k in range(lasers):
        rows = order[starts[k] : starts[k + 1]]
        if len(rows) < 3:
            continue
        near = np.ones(len(rows), np.bool_)
        size = np.empty(len(rows))
        for _ in range(10):
            slope[k], height[k] = _line(rho, z, rows, near)
            for j in range(len(rows)):
                off[rows[j]] = z[rows[j]] - slope[k] * rho[rows[j]] - height[k]
                size[j] = abs(off[rows[j]])
            limit = max(1e-6, 2.0 * np.median(size))
            near[:] = size <= limit
    return slope, height, off


@njit(cache=True, error_model="numpy")
def _without_lines(columns: F64, rho: F64, good: NDArray[np.bool_], order: I64, starts: I64) -> None:
    """Take out of the columns ``(N, C)`` what a slope and a height of each laser could take up, over its good rows."""
    for k in range(len(starts) - 1):
        rows = order[starts[k] : starts[k + 1]]
        near = good[rows]
        if near.sum() > 2:
            for c in range(columns.shape[1]):
                slope, height = _line(rho, columns[:, c], rows, near)
                for j in range(len(rows)):
                    if near[j]:
                        columns[rows[j], c] -= slope * rho[rows[j]] + height


@dataclass(frozen=True, eq=False)
class OnCones:
    """Points ``(N, 3)`` that tell something, their lasers and places ``(N,)``, and what cones say of their motion: all but the yaw."""

    points: F64
    laser: I64
    s: F64
    lasers: int
    motion: F64

    @property
    def few(self) -> slice:
        """A sample of the points."""
        return slice(None, None, len(self.points) // _SAMPLE + 1)

    def are_of(self, sensor: SensorModel) -> bool:
        """Tell whether the cones may be those of a sensor: steps that are sought for others are sought in vain, and that takes seconds."""
        few = self.few
        laser = self.laser[few]
        slope = fit_cones(undo(self.points[few], self.s[few], self.motion), laser, self.lasers)[0].slope
        apart = np.abs(slope[:, None] - np.tan(sensor.theta)[None, :]).min(axis=1)
        return bool(np.median(apart[laser]) < _ANOTHER)


def solve(points: F64, laser: I64, s: F64, lasers: int, ticks: int = 0, count: float = 0.0) -> Solved | None:
    """Find the motion of points ``(N, 3)`` of lasers ``(N,)`` at places ``(N,)``; None where nothing locks.

    Args:
        ticks, count: the sensor's steps; 0 where they are not known.
    """
    on_cones = put_on_cones(points, laser, s, lasers)
    return None if on_cones is None else lock(on_cones, ticks, count)


def put_on_cones(points: F64, laser: I64, s: F64, lasers: int) -> OnCones | None:
    """Take the first step of :func:`solve`; None where points make no cones."""
    points, laser, s = _telling(points, laser, s)
    if len(points) < _SAMPLE // 10:
        return None
    found = OnCones(points, laser, s, lasers, np.zeros(6))
    few = found.few
    try:
        for _ in range(6):
            motion = _by_cones(points[few], laser[few], s[few], lasers, found.motion, (0, 1, 2, 3, 4))
            found = replace(found, motion=motion)
    except np.linalg.LinAlgError:  # nothing like a turn of a sensor
        return None
    return found


def _telling(points: F64, laser: I64, s: F64) -> tuple[F64, I64, F64]:
    """The points ``(N, 3)`` that tell something of a motion, their lasers and places."""
    ok = (laser >= 0) & (np.hypot(points[:, 0], points[:, 1]) > _NEAREST)
    return points[ok], laser[ok], s[ok]


def follow(points: F64, laser: I64, s: F64, lasers: int, before: F64, ticks: int, count: float) -> F64 | None:
    """Take the steps of :func:`solve` from the motion ``(6,)`` of the scan before; whether what they lead to fits is for the caller to see.

    The yaw is found but for ticks more from place to place: the next to that of the scan before is taken.
    """
    points, laser, s = _telling(points, laser, s)
    if len(points) < _SAMPLE // 10:
        return None
    few = slice(None, None, len(points) // _SAMPLE + 1)
    try:
        motion = _by_counts(points, laser, s, lasers, before, count)
        for _ in range(2):
            motion = _by_cones(points[few], laser[few], s[few], lasers, motion, (3, 4))
    except np.linalg.LinAlgError:
        return None
    turned = _by_ticks(undo(points, s, motion), laser, s, lasers, (ticks,))
    if turned is None:
        return None
    alias = 2.0 * np.pi / ticks / float(np.min(np.diff(np.unique(s)), initial=1.0))
    motion[5] += turned[0] - alias * np.rint(turned[0] / alias)
    return motion


def lock(found: OnCones, ticks: int = 0, count: float = 0.0) -> Solved | None:
    """Take the other steps of :func:`solve`."""
    try:
        return _locked(found, ticks, count)
    except np.linalg.LinAlgError:
        return None


def _locked(found: OnCones, ticks: int, count: float) -> Solved | None:
    points, laser, s, lasers, motion = found.points, found.laser, found.s, found.lasers, found.motion
    few = found.few
    early = np.abs(s) <= np.quantile(np.abs(s), min(max(0.1, _ENOUGH * lasers / len(s)), 1.0))
    if not count:
        raw = undo(points[early], s[early], motion)
        reach = np.sqrt((raw**2).sum(axis=1))
        count, sharp = find_count([reach[laser[early] == k] for k in range(lasers)])
        if not sharp:
            return None
    motion = _by_counts(points, laser, s, lasers, motion, count)
    for _ in range(2):
        motion = _by_cones(points[few], laser[few], s[few], lasers, motion, (3, 4))
    turned = _by_ticks(undo(points, s, motion), laser, s, lasers, (ticks,) if ticks else TICKS)
    if turned is None:
        return None
    motion[5], ticks = turned
    return Solved(motion, ticks, count)


def find_motion(points: NDArray[np.float32], sensor: SensorModel) -> F64 | None:
    """Return the motion that moved the points ``(N, 3)`` of a known sensor off its lattice; None where there is none to be found."""
    wide = points.astype(np.float64)
    firing = find_firing(wide)
    # Lasers that look at the sky may lack in a model, but not many.
    if not sensor.n_lasers <= firing <= 2 * sensor.n_lasers:
        return None
    s = places(len(wide), firing)
    seen = Listed(wide).seen
    laser = np.where(seen, np.arange(len(wide)) % firing, -1)
    found = solve(wide, laser, s, firing, sensor.ticks_per_turn, sensor.count)
    if found is None:
        return None
    before, after = (aim(sensor, q[seen])[3] < _ON_LATTICE for q in (wide, undo(wide, s, found.motion)))
    return found.motion if after.mean() > before.mean() + _WORTH_IT else None


def _by_cones(points: F64, laser: I64, s: F64, lasers: int, motion: F64, free: tuple[int, ...]) -> F64:
    """One Gauss-Newton step of the components ``free`` on what cones are left when they are fitted anew."""
    raw = undo(points, s, motion)
    cones, off = fit_cones(raw, laser, lasers)
    rho = np.hypot(raw[:, 0], raw[:, 1])
    slope = cones.slope[laser]
    normal = np.stack([-slope * raw[:, 0] / rho, -slope * raw[:, 1] / rho, np.ones(len(raw))], axis=1)
    # d raw / d v = -s, d raw / d w = -s w x raw; what depends on w and the normal alone is their triple product.
    jacobian = np.concatenate([-s[:, None] * normal, -s[:, None] * np.cross(raw, normal)], axis=1)[
        :, list(free)
    ]
    # Cones are fitted together with the motion: what they could take up is taken out of the columns, too.
    good = np.abs(off) < 4.0 * np.median(np.abs(off))
    _without_lines(jacobian, rho, good, *_grouped(laser, lasers))
    change = np.zeros(6)
    change[list(free)] = np.linalg.lstsq(jacobian[good], -off[good], rcond=None)[0]
    return np.asarray(motion + change)


def _by_counts(points: F64, laser: I64, s: F64, lasers: int, motion: F64, count: float) -> F64:
    """Adjust v until ranges are whole counts, from the end of the turn on, where it hardly matters."""
    motion = motion.copy()
    sector = _SECTOR
    while True:
        near = np.flatnonzero(np.abs(s) < sector)
        near = near[:: len(near) // _IN_SECTOR + 1]
        own, place, k = points[near], s[near], laser[near]
        for _ in range(4):
            raw = undo(own, place, motion)
            reach = np.sqrt((raw**2).sum(axis=1))
            phase = np.exp(2j * np.pi * reach / count)
            sums = np.bincount(k, phase.real, lasers) + 1j * np.bincount(k, phase.imag, lasers)
            off = np.angle(phase * np.exp(-1j * np.angle(sums))[k]) / (2 * np.pi) * count
            jacobian = -place[:, None] * raw / reach[:, None]
            good = np.abs(off) < 0.4 * count
            # A sector says nothing of what it does not show: the change is held back there.
            held = jacobian[good].T @ jacobian[good] + 1e-4 * good.sum() * sector**2 * np.eye(3)
            motion[:3] -= np.linalg.solve(held, jacobian[good].T @ off[good])
        if sector >= 1.0:
            return motion
        sector = min(sector * _WIDER, 1.0)


def _by_ticks(
    raw: F64, laser: I64, s: F64, lasers: int, candidates: tuple[int, ...]
) -> tuple[float, int] | None:
    """Return the yaw per turn at which azimuths are whole ticks, and which ones; None where they never are."""
    azimuth = np.arctan2(raw[:, 1], raw[:, 0])
    far = np.hypot(raw[:, 0], raw[:, 1]) > 8.0
    step = max(float(np.min(np.diff(np.unique(s)), initial=1.0)), 2.0 / _PADDED)
    place = np.rint((s - s.min()) / step).astype(np.int64)
    best, sharpest = None, _LINE
    for ticks in candidates:
        total = np.zeros(_PADDED)
        seen = 0
        for k in range(0, lasers, lasers // _LASERS + 1):
            own = far & (laser == k)
            if own.sum() < 50:
                continue
            phase = np.exp(1j * ticks * azimuth[own])
            line = np.bincount(place[own], phase.real, _PADDED) + 1j * np.bincount(
                place[own], phase.imag, _PADDED
            )
            total += np.abs(np.fft.fft(line[:_PADDED]))
            seen += int(own.sum())
        if not seen:
            continue
        turned = np.fft.fftfreq(_PADDED, 1 / (2 * np.pi)) / (ticks * step)
        total[np.abs(turned) > FASTEST] = 0.0
        at = int(total.argmax())
        if total[at] / seen > sharpest:
            best, sharpest = (float(turned[at]), ticks), float(total[at] / seen)
    return best
