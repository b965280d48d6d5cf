"""The frame of a map: where its origin lies in the frame of its poses, and what its files say of values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.las import intensity_factors
from salpcc.stages.mapping.tiles import Box


@dataclass(frozen=True)
class Frame:
    """What the files of a map say of it.

    Attributes:
        origin: of the map's frame in the frame of its poses, metres, float64; zeros where they are the same.
        factor: by which LAS holds intensities.
        crs: coordinate system of the poses, such as EPSG:25832, for LAS; None where nobody said.
    """

    origin: tuple[float, float, float]
    factor: int
    crs: str | None = None


def box_around(xyz: NDArray[np.float64], frame: Frame) -> list[float]:
    """Return the box x0, y0, z0, x1, y1, z1 around places ``(N, 3)`` of a map, in the frame of its poses, to the millimetre."""
    return [round(value, 3) for value in Box.around(xyz).moved(frame.origin).numbers]


def frame_of(origin: tuple[float, float, float], archive: Path, crs: str | None) -> Frame:
    """Settle what the files of a map say of it; the unit of intensity is that of its first ``archive``."""
    with Archive.open(archive) as opened:
        return Frame(origin, min(intensity_factors(opened).values(), default=1), crs)
