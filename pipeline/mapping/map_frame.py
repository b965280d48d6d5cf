"""The frame of a map: where its origin lies in the frame of its poses, and what its files say of values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.las import intensity_factors


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


def frame_of(origin: tuple[float, float, float], archive: Path, crs: str | None) -> Frame:
    """Settle what the files of a map say of it; the unit of intensity is that of its first ``archive``."""
    with Archive.open(archive) as opened:
        return Frame(origin, min(intensity_factors(opened).values(), default=1), crs)
