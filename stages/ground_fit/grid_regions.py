"""Regions of the range image's ground: azimuth sectors by distance rings (paper, section V-A).

Which region a cell is in must be known before its range is, so its distance is that at which its beam would
meet level ground.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.ingest.paper_grid import ELEVATION_UNIT
from salpcc.stages.lattice.trig import PI, sin_cos

SECTORS = 20
RINGS = (0.0, 5.0, 6.0, 7.2, 8.6, 10.4, 12.5, 15.0, 18.0, 22.0, 28.0, 40.0)  # metres, from
HEIGHT = 1.73  # of the sensor above level ground, metres
REGIONS = SECTORS * len(RINGS)


def region_image(elevation: NDArray[np.int16]) -> NDArray[np.int32]:
    """Return the region ``ring * SECTORS + sector`` of each cell ``(64, 2000)``."""
    slopes = []
    for value in elevation:
        up, flat = sin_cos(float(value) * ELEVATION_UNIT)
        slopes.append(-up / flat)
    ring = [sum(slope * edge <= HEIGHT for edge in RINGS) - 1 for slope in slopes]
    sector = np.arange(COLUMNS) * SECTORS // COLUMNS
    return (np.array(ring, np.int32).reshape(ROWS, 1) * SECTORS + sector).astype(np.int32)


def centres() -> NDArray[np.float64]:
    """Return x, y of the middle of each region ``(REGIONS, 2)`` and its size in metres as a third column."""
    outer = (*RINGS[1:], 1.5 * RINGS[-1])
    rows = []
    for inner, edge in zip(RINGS, outer, strict=True):
        middle = 0.5 * (inner + edge)
        for sector in range(SECTORS):
            s, c = sin_cos((1.0 - 2.0 * (sector + 0.5) / SECTORS) * PI)
            rows.append((middle * c, middle * s, max(edge - inner, middle * 2.0 * PI / SECTORS)))
    return np.array(rows)
