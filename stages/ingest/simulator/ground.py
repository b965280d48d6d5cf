"""Shape the ground: road with crown and markings, parking strip, kerb, sidewalk, open land."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.simulator.drive import CentreLine, Lengths
from salpcc.stages.ingest.simulator.materials import NAMES
from salpcc.stages.ingest.simulator.mesh import Mesh, grid, merge, surface

F64 = NDArray[np.float64]
ROAD, PARKING, SIDEWALK, LANE_MARKING, TERRAIN = 40, 44, 48, 60, 72
KERB = 0.12  # metres
_ROW = 2.0  # metres between rows of the height field
_FAR = (14.0, 22.0, 34.0, 52.0, 75.0)  # metres from the axis


@dataclass(frozen=True)
class Stretch:
    """One stretch of street on one side of the axis: what its strips are and how wide, metres."""

    start: float
    end: float
    side: int
    kind: str
    parking: float
    sidewalk: float
    verge: float

    def edge(self, road: float) -> float:
        """Return the distance from the axis to the outer edge of the sidewalk."""
        return road + self.parking + self.sidewalk


def height(s: Lengths, left: Lengths, road: float) -> F64:
    """Return how far the open ground lies above the axis ``left`` metres beside length ``s``."""
    out = np.maximum(np.abs(left) - road, 0.0)
    side = np.sign(left)
    bank = np.sin(s / 41.0 + 1.3 * side) * 0.035 + np.sin(s / 13.0 - side) * 0.008
    return np.asarray(-0.02 * np.minimum(np.abs(left), road) + bank * np.maximum(out - 4.0, 0.0))


def ground(line: CentreLine, stretches: list[Stretch], road: float, crossings: list[float]) -> Mesh:
    """Shape both sides of the street over all stretches and the markings on it."""
    parts = []
    for side in (1, -1):
        for st in (st for st in stretches if st.side == side):
            s = np.linspace(st.start, st.end, int(np.ceil((st.end - st.start) / _ROW)) + 1)
            kerb = road + st.parking
            edges = [0.0, road, kerb, kerb + 0.03, st.edge(road), st.edge(road) + st.verge]
            edges += [max(f, edges[-1] + 1.0 + i) for i, f in enumerate(_FAR)]
            rows, cols = np.meshgrid(s, np.array(edges), indexing="ij")
            crossing = np.zeros_like(s, bool)
            for c in crossings:
                crossing |= np.abs(s - c) < 4.0
            up = height(rows, cols * side, road)
            up[:, 3:] += np.where(crossing, 0.0, KERB)[:, None]
            points = line.place(rows, cols * side)
            points[..., 2] += up
            verge = ("paving", SIDEWALK) if st.kind == "row" else ("grass", TERRAIN)
            strips = [
                ("asphalt", ROAD),
                ("asphalt", PARKING),
                ("paving", SIDEWALK),
                ("paving", SIDEWALK),
                verge,
            ]
            strips += [("grass", TERRAIN)] * len(_FAR)
            cell = (len(s) - 1, len(edges) - 1)
            material = np.broadcast_to(np.array([NAMES[n] for n, _ in strips], np.uint8), cell).copy()
            label = np.broadcast_to(np.array([i for _, i in strips], np.uint32), cell).copy()
            across = crossing[1:] & crossing[:-1]
            material[across], label[across] = NAMES["asphalt"], ROAD
            parts.append(grid(points, material, label))
    return merge([*parts, _markings(line, road)])


def _markings(line: CentreLine, road: float) -> Mesh:
    """Shape the dashed centre line and the edge lines, 4 mm above the asphalt."""
    s = np.arange(line.s[0], line.s[-1] - 8, 9.0)
    quads = [(s, 3.0, 0.0)] + [
        (np.arange(line.s[0], line.s[-1] - 3, 3.0), 3.0, y * (road - 0.3)) for y in (1, -1)
    ]
    corners = []
    for start, length, left in quads:
        for along, wide in ((0.0, -0.06), (length, -0.06), (length, 0.06), (0.0, 0.06)):
            p = line.place(start + along, np.full_like(start, left + wide))
            p[:, 2] += 0.004 - 0.02 * abs(left)
            corners.append(p)
    points = np.concatenate([np.stack(corners[i : i + 4], 1).reshape(-1, 3) for i in (0, 4, 8)])
    first = np.arange(len(points) // 4)[:, None] * 4
    fan = np.concatenate([first + (0, 1, 2), first + (0, 2, 3)])
    return surface(points, fan, NAMES["marking"], ROAD)
