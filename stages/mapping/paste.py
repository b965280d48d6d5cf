"""Paste simulated movers into scans: what a passer-by would have sent back is known to the point, so cleaning can be scored.

Each is a box that drives or walks along, or across, the way of the sensor. A return whose ray meets a box before it ended is
moved to where it meets it; nothing else is touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# Length, width, height in metres, and metres per turn: a car, a lorry, a cyclist, a person.
_KINDS = ((4.3, 1.8, 1.5, 0.9), (8.0, 2.5, 3.0, 0.7), (1.8, 0.6, 1.7, 0.4), (0.5, 0.5, 1.7, 0.14))
_LANES = (-5.0, -3.2, 3.2, 5.0)  # metres beside the way
_AHEAD = (-15.0, 30.0)  # metres along it, when it is met
_FARTHEST = 60.0  # metres from the sensor, beyond which hardly a ray meets it
_NEAREST = 3.0  # metres from the sensor, within which nothing is pasted


@dataclass(frozen=True)
class Mover:
    """A box that moves: its size, and its pose ``(n, 4, 4)``, of the middle of its floor, at each scan."""

    size: tuple[float, float, float]
    poses: F64


def movers_of(poses: F64, ground: float, number: int, seed: int) -> list[Mover]:
    """Make movers for a stretch of poses ``(n, 4, 4)``; ``ground`` is how high it lies in the sensor's frame, metres."""
    rng, n, out = np.random.default_rng(seed), len(poses), []
    for k in range(number):
        length, width, height, speed = _KINDS[k % len(_KINDS)]
        met = int(rng.integers(n))
        across = k % len(_KINDS) == 3 and bool(rng.integers(2))  # some walk across
        heading = float(rng.choice([0.0, np.pi])) + (np.pi / 2 if across else 0.0)
        start = np.eye(4)
        start[:3, :3] = [
            [np.cos(heading), -np.sin(heading), 0],
            [np.sin(heading), np.cos(heading), 0],
            [0, 0, 1],
        ]
        start[:3, 3] = rng.uniform(*_AHEAD), rng.choice(_LANES), ground
        at = poses[met] @ start
        path = np.repeat(at[None], n, axis=0)
        path[:, :3, 3] += ((np.arange(n) - met) * speed)[:, None] * at[:3, 0]
        out.append(Mover((length, width, height), path))
    return out


def paste(points: F64, pose: F64, movers: Sequence[Mover], scan: int) -> tuple[F64, NDArray[np.bool_]]:
    """Return the points ``(N, 3)`` that a scan at ``pose`` would have had, and which of them ``(N,)`` are of a mover.

    Args:
        points: in the sensor's frame, de-skewed.
        scan: place in the stretch of the movers.
    """
    share = np.ones(len(points))
    for mover in movers:
        to_box = np.linalg.inv(mover.poses[scan]) @ pose
        if np.linalg.norm(to_box[:3, 3]) > _FARTHEST:
            continue
        share = np.minimum(share, _entry(points, to_box, mover.size))
    hit = share < 1.0
    return np.where(hit[:, None], points * share[:, None], points), hit


def ground_under(points: F64) -> float:
    """Estimate how high the ground lies in the frame of a sensor ``(N, 3)``, metres: the lowest that many points around share."""
    flat = np.hypot(points[:, 0], points[:, 1])
    around = points[(flat > 3.0) & (flat < 12.0), 2]
    return float(np.quantile(around, 0.2)) if len(around) else -1.7


def _entry(points: F64, to_box: F64, size: tuple[float, float, float]) -> F64:
    """Return at which part of its way each ray from the sensor to a point enters a box, 1 where it does not."""
    eye = to_box[:3, 3]
    ahead = points @ to_box[:3, :3].T
    low = np.array([-size[0] / 2, -size[1] / 2, 0.0])
    high = np.array([size[0] / 2, size[1] / 2, size[2]])
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(low - eye) / ahead, (high - eye) / ahead])
        enters = np.nan_to_num(sides.min(axis=0), nan=-np.inf).max(axis=1)
        leaves = np.nan_to_num(sides.max(axis=0), nan=np.inf).min(axis=1)
        near = _NEAREST / np.linalg.norm(points, axis=1)
    return np.where((enters < leaves) & (enters > near) & (enters < 1.0), enters, 1.0)
