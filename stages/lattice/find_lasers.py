"""Which laser measured each point of an unknown sensor: from ring numbers, the sines of elevations, rows, the way the list goes round, or elevation.

In this order; the first that puts most points onto narrow cones is taken. Lasers are numbered as they were found: by ring
number, row, place in the file or in a firing, or from the top down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SensorError

MOST_LASERS = 256
LEAST_POINTS = 500
NEAREST = 0.7  # metres; less is no return, or the vehicle's own roof
_NEAREST_NUMBERED = 0.05  # metres; where the sensor tells the laser, a roof is as good as a wall
_LONGEST = 1 << 14  # points looked at for firings
_EVERY = 17  # of which one is at first; a prime, so that every laser is seen
_FAR = 4.0  # metres; nearer points show where a laser sits instead of its elevation
_FARTHEST = 0.75  # of the points are nearer than that in a small room, and must do
_NARROW = (
    0.02  # of slopes within a laser; neighbours are 0.003 to 0.04 apart, but cones of moved scans are smeared
)
_PER_DEGREE = 50
_SMOOTH = 4  # cells
_ONE_SINE = 2e-6  # between points of a laser without lever arms; float32 leaves a tenth of that
_FEWEST_OF_SINE, _HAVE_SINES = 50, 0.9  # points of a laser, and of all returns
_LOWEST_PEAK = 0.1  # of the median peak


@dataclass(frozen=True, eq=False)
class Listed:
    """The points of one scan as they were listed.

    Attributes:
        points: ``(N, 3)`` float64 metres.
        ring: ``(N,)`` int64, the sensor's own laser numbers, or None.
        width: points in a row of an organised cloud, else 0.
        time: ``(N,)`` int64, of each point in whole steps, or None.
    """

    points: NDArray[np.float64]
    ring: NDArray[np.int64] | None = None
    width: int = 0
    time: NDArray[np.int64] | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Mark points that are returns: finite, not at the sensor."""
        with np.errstate(invalid="ignore", over="ignore"):
            reach = np.sqrt((self.points**2).sum(axis=1))
            return (reach > (NEAREST if self.ring is None else _NEAREST_NUMBERED)) & (reach < 1e4)


def with_lasers(scans: list[Listed]) -> list[Listed]:
    """Number the lasers of scans that tell none by the sines of their elevations, top first; as they are where sines do not tell them.

    Drivers that know no lever arms make z of the range and one sine a laser, so points of a laser have the same but for roundings, however near they are.
    """
    if any(scan.ring is not None for scan in scans):
        return scans
    numbered = [replace(scan, ring=np.full(len(scan.points), -1)) for scan in scans]
    seen = [scan.seen for scan in numbered]
    points = np.concatenate([scan.points[ok] for scan, ok in zip(scans, seen, strict=True)])
    if not len(points):
        return scans
    sine = points[:, 2] / np.sqrt((points**2).sum(axis=1))
    order = np.argsort(-sine, kind="stable")
    group = np.cumsum(-np.diff(sine[order], prepend=sine[order[:1]]) > _ONE_SINE)
    size = np.bincount(group)
    last = np.cumsum(size) - 1
    width = sine[order[last - size + 1]] - sine[order[last]]
    kept = (size >= _FEWEST_OF_SINE) & (width < _ONE_SINE)
    if not 2 <= kept.sum() <= MOST_LASERS or size[kept].sum() < _HAVE_SINES * len(points):
        return scans
    laser = np.empty(len(points), np.int64)
    laser[order] = np.where(kept, np.cumsum(kept) - 1, -1)[group]
    for scan, ok, own in zip(
        numbered, seen, np.split(laser, np.cumsum([ok.sum() for ok in seen])[:-1]), strict=True
    ):
        assert scan.ring is not None
        scan.ring[ok] = own
    return numbered


def find_lasers(scans: list[Listed]) -> tuple[list[NDArray[np.int64]], int]:
    """Return the laser of each point of each scan ``(N,)`` (-1: none), and the lasers of a firing where firings are listed, else 0.

    Raises:
        SensorError: too few points, or no way to order them makes cones: this is no spinning LiDAR.
    """
    seen = sum(int(scan.seen.sum()) for scan in scans)
    if seen < LEAST_POINTS:
        raise SensorError(f"{seen} points, at least {LEAST_POINTS} are needed: use more scans")
    for found, period in _guesses(scans):
        lasers = 1 + max(int(k.max(initial=-1)) for k in found)
        if 2 <= lasers <= MOST_LASERS and _spread(scans, found) < _NARROW:
            return found, period
    raise SensorError(
        "the points lie on no cones around the z axis: this is no spinning LiDAR in its own frame"
    )


def _guesses(scans: list[Listed]) -> Iterator[tuple[list[NDArray[np.int64]], int]]:
    """Ways to give every point of every scan a laser, the most certain first."""
    firing = find_firing(max((scan.points for scan in scans), key=len))
    rings = [scan.ring for scan in scans if scan.ring is not None]
    if len(rings) == len(scans):
        yield [np.where(scan.seen, ring, -1) for scan, ring in zip(scans, rings, strict=True)], firing
    if all(scan.width > 1 for scan in scans):
        for by_row in (True, False):
            yield (
                [_kept(s, np.arange(len(s.points)) // s.width if by_row else np.arange(len(s.points)) % s.width)
                 for s in scans],
                0 if by_row else scans[0].width,
            )  # fmt: skip
    if firing:
        yield [_kept(scan, np.arange(len(scan.points)) % firing) for scan in scans], firing
    ways = [[way(scan) for scan in scans] for way in (_by_seam, _by_turns)]
    for found in sorted(ways, key=lambda found: _spread(scans, found)):
        common = int(np.bincount([int(k.max()) + 1 for k in found]).argmax())
        yield [k if k.max() + 1 == common else np.full(len(k), -1) for k in found], 0
    # Near points tell lasers that look down from their neighbours, unless the lasers sit far apart.
    far = _far(scans)
    ways = [_by_elevation(scans, nearest) for nearest in (far, far / 2)]
    yield min(ways, key=lambda found: _spread(scans, found, far / 2, np.mean)), 0


def _kept(scan: Listed, laser: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.where(scan.seen, laser, -1)


def _by_seam(scan: Listed) -> NDArray[np.int64]:
    """Files that list ring after ring, each from azimuth 0 on: it falls by more than half a turn between two."""
    where = np.flatnonzero(scan.seen)
    azimuth = np.arctan2(scan.points[where, 1], scan.points[where, 0]) % (2 * np.pi)
    laser = np.full(len(scan.points), -1)
    laser[where] = np.cumsum(np.diff(azimuth, prepend=azimuth[:1]) < -np.pi)
    return laser


def _by_turns(scan: Listed) -> NDArray[np.int64]:
    """Files that list ring after ring, each from anywhere on: every ring is a whole turn, either way round."""
    where = np.flatnonzero(scan.seen)
    azimuth = np.arctan2(scan.points[where, 1], scan.points[where, 0])
    steps = np.diff(azimuth, prepend=azimuth[:1])
    turns = np.abs(np.cumsum((steps + np.pi) % (2 * np.pi) - np.pi)) / (2 * np.pi)
    laser = np.full(len(scan.points), -1)
    laser[where] = np.minimum(turns, max(np.rint(turns[-1:].sum()) - 1, 0)).astype(np.int64)
    return laser


def find_firing(points: NDArray[np.float64]) -> int:
    """Points of a firing where a list goes firing by firing: the lag at which elevations repeat, 0 for none."""
    slope = _slopes(points[:_LONGEST])
    lags = np.arange(4, min(MOST_LASERS, len(slope) // 4) + 1)
    if len(lags) < 2:
        return 0
    few = _apart(slope, lags, _EVERY)
    if np.isnan(few).all() or np.nanmin(few) > 0.4 * np.nanmedian(few):
        return 0
    lags = lags[few <= 3.0 * np.nanmin(few) + 1e-3]  # of which all points are looked at
    apart = _apart(slope, lags)
    best = int(np.nanargmin(apart))
    # Every multiple of a period is one, too; and a list of rings is alike at every lag.
    smallest = int(lags[np.flatnonzero(apart <= 1.5 * apart[best] + 1e-4)[0]])
    return smallest if apart[best] < 0.2 * np.nanmedian(few) else 0


def _apart(slope: NDArray[np.float64], lags: NDArray[np.int64], every: int = 1) -> NDArray[np.float64]:
    """How far apart half of the slopes ``(N,)`` are from those so many places on, of each lag ``(L,)``; NaN where there are none. ``every``: places of which one is looked at."""
    with np.errstate(all="ignore"):
        return np.array([_median(np.abs(slope[lag::every] - slope[:-lag:every])) for lag in lags])


def _median(values: NDArray[np.float64]) -> float:
    """``np.nanmedian`` of values ``(N,)``, in a fifth of its time; NaN where there are none."""
    known = values[~np.isnan(values)]
    middle = len(known) // 2
    if not len(known):
        return np.nan
    if len(known) % 2:
        return float(np.partition(known, middle)[middle])
    return float(np.partition(known, (middle - 1, middle))[middle - 1 : middle + 1].mean())


def _by_elevation(scans: list[Listed], nearest: float) -> list[NDArray[np.int64]]:
    """The peak of the elevations of all scans that a point is nearest to, top first."""
    cells = [
        np.nan_to_num((np.degrees(np.arctan(_slopes(s.points))) + 90.0) * _PER_DEGREE).astype(np.int64)
        for s in scans
    ]
    counts = np.zeros(180 * _PER_DEGREE + 1)
    for scan, cell in zip(scans, cells, strict=True):
        far = scan.seen & (np.nan_to_num(np.hypot(*scan.points[:, :2].T)) > nearest)
        counts += np.bincount(cell[far], minlength=len(counts))
    reach = np.arange(-3 * _SMOOTH, 3 * _SMOOTH + 1)
    smooth = np.convolve(counts, np.exp(-0.5 * (reach / _SMOOTH) ** 2), "same")
    peaks = np.flatnonzero((smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])) + 1
    if not len(peaks):
        return [np.full(len(s.points), -1) for s in scans]
    peaks = peaks[smooth[peaks] > _LOWEST_PEAK * np.median(smooth[peaks])]
    middles = (peaks[1:] + peaks[:-1]) / 2.0
    return [
        _kept(scan, len(peaks) - 1 - np.searchsorted(middles, cell))
        for scan, cell in zip(scans, cells, strict=True)
    ]


def _far(scans: list[Listed]) -> float:
    """How far away a point must be to tell a laser's elevation, metres."""
    ground = np.concatenate([np.hypot(*scan.points[scan.seen, :2].T) for scan in scans])
    return min(_FAR, float(np.quantile(ground, _FARTHEST)))


def _slopes(points: NDArray[np.float64], nearest: float = NEAREST) -> NDArray[np.float64]:
    """z over the horizontal distance, NaN where there is no return."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ground = np.hypot(points[:, 0], points[:, 1])
        return np.where(ground > nearest, points[:, 2] / ground, np.nan)


def _spread(
    scans: list[Listed],
    found: list[NDArray[np.int64]],
    nearest: float | None = None,
    over: Callable[[list[float]], np.floating[Any]] = np.median,
) -> float:
    """Median (or another summary) over the lasers of how far half of the slopes of a laser's points reach."""
    slopes, lasers, grounds = [], [], []
    nearest = _far(scans) if nearest is None else nearest
    for scan, laser in zip(scans, found, strict=True):
        ok = (laser >= 0) & (np.nan_to_num(np.hypot(*scan.points[:, :2].T)) > nearest)
        slopes.append(_slopes(scan.points, min(nearest, NEAREST))[ok])
        grounds.append(np.hypot(*scan.points[ok, :2].T))
        lasers.append(laser[ok])
    slope, laser, ground = np.concatenate(slopes), np.concatenate(lasers), np.concatenate(grounds)
    if not len(slope):
        return np.inf
    parts = [slope[laser == k] for k in np.unique(laser)]
    if nearest < _FAR / 2:  # so near, a laser's own height is most of its slopes
        parts = [
            _levelled(part, rho)
            for part, rho in zip(parts, [ground[laser == k] for k in np.unique(laser)], strict=True)
        ]
    return float(over([float(np.subtract(*np.quantile(part, (0.75, 0.25)))) for part in parts]))


def _levelled(slope: NDArray[np.float64], ground: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes of one laser at horizontal distances, without what its height adds."""
    inverse = 1.0 / ground
    middle = np.median(inverse)
    near, far = inverse > middle, inverse < middle
    if not near.any() or not far.any():
        return slope
    height = (np.median(slope[near]) - np.median(slope[far])) / (
        np.median(inverse[near]) - np.median(inverse[far])
    )
    return np.asarray(slope - height * inverse)
