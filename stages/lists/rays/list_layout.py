"""How a list of points goes round its sensor: which earlier point is the same laser's, which the neighbour's.

See :mod:`.ray_coder`. Guessed from how elevation and azimuth repeat along the list, then tried on a part of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import room_for
from salpcc.stages.lists.rays.ray_coder import Layout
from salpcc.stages.lists.rays.ray_forms import ALONG
from salpcc.stages.lists.rays.ray_stream import move_points, write_points

_FEW = 500
_TRIED, _PERIODS = (4096, 32768), 4  # points at least and at most; a quarter of a list, or some periods
_LASERS = (4, 260)  # lags that may be a firing
_COLUMNS = (260, 6000)  # and those that may be a ring
_LONGEST = 1 << 15
_BETTER = 0.98  # a layout that saves less is chance


def likely_layouts(points: NDArray[np.float32], lanes: bool) -> list[Layout]:
    """Return the layouts (left, up) that points ``(S, 3)`` may lie in, the plain list first; ``lanes``: firings with gaps, too."""
    if len(points) < _FEW:
        return [(1, 0)]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        x, y, z = np.nan_to_num(points[:_LONGEST].astype(np.float64), posinf=0.0, neginf=0.0).T
        x, y, z = (np.clip(c, -1e6, 1e6) for c in (x, y, z))
        ground = np.maximum(np.hypot(x, y), 1e-9)
    found = [(1, 0)]
    found += [(lag, 1) for lag in _repeats(np.clip(z / ground, -2, 2), *_LASERS)]
    found += [(1, lag) for lag in _repeats(x / ground + 1j * y / ground, *_COLUMNS)]
    return [*found, (0, 1)] if lanes else found


def find_layout(
    points: NDArray[np.float32],
    form: int,
    per: float,
    step: float,
    tolerance: float,
    lanes: NDArray[np.uint8] | None = None,
    like: Layout | None = None,
) -> Layout:
    """Return (left, up) of the points ``(S, 3)`` that codes them in the fewest bytes, of a few likely ones.

    ``tolerance`` as for :func:`ray_stream.move_points`. Points that were moved once by a layout come out best by the same, as
    all others would have to leave them loose; this is why the part that is tried stands at the beginning.
    ``like`` is taken without a trial.
    """
    if like is not None and len(points) >= _FEW:
        return like
    # Lanes of points that were moved would not be quite the same.
    candidates = likely_layouts(points, lanes=form != ALONG)
    if len(candidates) == 1 or len(points) < _FEW:
        return 1, 0
    period = max(max(layout) for layout in candidates)
    part = np.ascontiguousarray(points[: np.clip(max(len(points) // 4, _PERIODS * period), *_TRIED)])
    some = None if lanes is None else lanes[: len(part)]
    out = np.empty(16 * len(part) + 4096, np.uint8)
    sizes: list[float] = []
    for layout in candidates:
        moved = part if tolerance == 0.0 else move_points(part, layout, form, per, step, tolerance, some)[0]
        size = write_points(moved, layout, form, per, step, out, some)
        sizes.append(size if size >= 0 else np.inf)
        if size >= 0:  # what takes more than the best so far need not be written to its end
            out = room_for(len(out), size)
    best = int(np.argmin(sizes))
    return candidates[best] if sizes[best] < _BETTER * sizes[0] else candidates[0]


def _repeats(values: NDArray[np.float64] | NDArray[np.complex128], low: int, high: int) -> list[int]:
    """Lag in [low, high) at which a series is most like itself, and the part of it that is nearly as good; none if it is short."""
    high = min(high, len(values) // 3)
    if high <= low:
        return []
    centred = values - values.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(values))))
    power = np.abs(np.fft.fft(centred, size)) ** 2
    likeness = np.fft.ifft(power).real[:high] / (len(values) - np.arange(high))
    best = int(low + np.argmax(likeness[low:high]))
    # Every multiple of a period is one, too: the smallest part of the best lag that is nearly as good.
    for parts in range(8, 1, -1):
        near = np.arange(max(best // parts - 2, low), min(best // parts + 4, high))
        if len(near) and likeness[near].max() >= likeness[best] - 0.03 * abs(likeness[0]):
            return [best, int(near[np.argmax(likeness[near])])]
    return [best]
