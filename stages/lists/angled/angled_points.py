"""A list of points on whole angles (:mod:`~salpcc.stages.lattice.whole_angles`) as bytes: those that are, and the others as any points off a lattice.

Body: the place of the unit (uint8), lasers (uint8), points off the angles (uint32), lengths of the lasers' elevations, of the gaps between those off, and
of these (uint32 each); the three; the walk of :mod:`.angled_coder`. A laser is what points are of whose elevations differ little from one to the next.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.integers import decode_column, encode_column
from salpcc.stages.entropy.range_coder import finish_encoder, start_decoder, start_encoder
from salpcc.stages.lattice.whole_angles import TURN, UNITS, find_angles, make_points
from salpcc.stages.lists.aimed.aimed_points import MOST_POINTS
from salpcc.stages.lists.angled.angled_coder import code_angled, new_models

_BODY = struct.Struct("<BBIIII")
_MOST_LASERS = 255
_WANDERS = 2000  # steps of elevation, from a point of a laser to the next
_FEWEST = 100  # points

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@njit(cache=True)
def _lasers(elevation: I64) -> tuple[NDArray[np.uint8], I64]:
    """Tell lasers ``(N,)`` apart, and what each has as its first elevation; none are returned if they are too many."""
    level, base = np.zeros(_MOST_LASERS, np.int64), np.zeros(_MOST_LASERS, np.int64)
    laser, lasers = np.zeros(len(elevation), np.uint8), 0
    for i in range(len(elevation)):
        nearest, off = -1, _WANDERS
        for k in range(lasers):
            if abs(elevation[i] - level[k]) < off:
                nearest, off = k, abs(elevation[i] - level[k])
        if nearest < 0:
            if lasers == _MOST_LASERS:
                return laser, base[:0]
            nearest, base[lasers] = lasers, elevation[i]
            lasers += 1
        level[nearest] = elevation[i]
        laser[i] = nearest
    return laser, base[:lasers]


def write_angled(points: F32, off: Callable[[F32], bytes]) -> bytes | None:
    """Encode points ``(N, 3)``, nearly all of which are on whole angles; None where they are not.

    Args:
        off: encodes the others.
    """
    made = find_angles(points) if _FEWEST <= len(points) <= MOST_POINTS else None
    if made is None:
        return None
    place, azimuth, elevation, count, found = made
    laser, base = _lasers(elevation[found])
    if len(base) == 0:
        return None
    order = np.argsort(-base, kind="stable")
    laser, base = np.argsort(order)[laser].astype(np.uint8), base[order]
    levels = encode_column(base)
    gaps = encode_column(np.diff(np.flatnonzero(~found), prepend=-1))
    rest = off(points[~found]) if len(gaps) else b""
    n = len(laser)

    def walk(out: NDArray[np.uint8]) -> int:
        state = start_encoder()
        angles = azimuth[found], elevation[found], count[found]
        code_angled(True, laser, *angles, _beside(base), base, UNITS[place], TURN, new_models(), state, out)
        return int(finish_encoder(state, out))

    head = _BODY.pack(place, len(base), len(points) - n, len(levels), len(gaps), len(rest))
    return head + levels + gaps + rest + run_encoder(walk, 3 * n)


def read_angled(
    n: int, data: NDArray[np.uint8], rest: Callable[[int, NDArray[np.uint8]], tuple[F32, bool]]
) -> tuple[F32, bool]:
    """Inverse of :func:`write_angled`: points ``(n, 3)``, and whether the data made sense; ``rest`` decodes the others."""
    points = np.zeros((n, 3), np.float32)
    if n > MOST_POINTS or len(data) < _BODY.size:
        return points, False
    place, lasers, n_off, *lengths = _BODY.unpack(data[: _BODY.size].tobytes())
    a, b, c = (int(end) for end in _BODY.size + np.cumsum(lengths))
    if place >= len(UNITS) or n_off > n or (lasers == 0 and n_off < n) or c > len(data):
        return points, False
    base, sound = decode_column(lasers, np.ascontiguousarray(data[_BODY.size : a]))
    gaps, told = decode_column(n_off, np.ascontiguousarray(data[a:b]))
    at = np.cumsum(gaps) - 1
    if not (sound and told and (gaps > 0).all() and (at < n).all()):
        return points, False
    on = np.ones(n, np.bool_)
    on[at] = False
    if n_off:
        points[at], sound = rest(n_off, np.ascontiguousarray(data[b:c]))
    laser, (azimuth, elevation, count) = np.zeros(n - n_off, np.uint8), np.zeros((3, n - n_off), np.int64)
    raw = np.ascontiguousarray(data[c:])
    state = start_decoder(raw)
    code_angled(
        False, laser, azimuth, elevation, count, _beside(base), base, UNITS[place], TURN, new_models(), state, raw
    )  # fmt: skip
    points[on] = make_points(azimuth, elevation, count, UNITS[place])
    return points, sound and bool(state[3] == 0)


def count_off_angles(body: bytes) -> int:
    """Of the points of a body, those on no whole angles."""
    return int(_BODY.unpack_from(body)[2])


def _beside(base: I64) -> tuple[I64, I64]:
    """The lasers above and below each, which fall in elevation; -1: none."""
    below = np.arange(1, len(base) + 1)
    below[-1:] = -1
    return np.arange(-1, len(base) - 1), below
