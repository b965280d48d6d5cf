"""Figures that the paper publishes, shown beside measured ones and always marked as published.

The paper's compression rates are taken on clean maps (movable points dropped, collided points lost) and its
base is assumed to be 16 bytes per point; its times come from a TITAN RTX.
"""

from __future__ import annotations

from typing import NamedTuple


class Published(NamedTuple):
    """One row: the system, its asked accuracy in metres (None for times alone), CR in percent, s a scan."""

    system: str
    accuracy: float | None
    rate_percent: float | None
    encode_s: float | None
    decode_s: float | None


# Table II (averages over sequences 11 to 21) and Table III of the paper.
PAPER: tuple[Published, ...] = (
    Published("SA-LPCC", 0.001, 4.16, 1.715, 1.160),
    Published("SA-LPCC", 0.005, 3.38, 1.715, 1.160),
    Published("SA-LPCC", 0.01, 2.77, 1.715, 1.160),
    Published("Octree", 0.001, 30.66, 0.024, 0.009),
    Published("Octree", 0.005, 20.57, 0.024, 0.009),
    Published("Octree", 0.01, 10.03, 0.024, 0.009),
    Published("PC-PNG", None, None, 0.106, 0.036),
    Published("PC-HEVC-Intra", None, None, 2.054, 0.038),
    Published("PC-HEVC-Inter", None, None, 8.489, 0.037),
    Published("Draco", None, None, 0.031, 0.010),
    Published("TMC13", None, None, 0.649, 0.337),
    Published("Feng's method", None, None, 0.019, 0.019),
    Published("Sun's method", None, None, 27.12, 0.04),
)
