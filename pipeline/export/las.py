"""What the LAZ files of decoded scans and of maps have in common: how they are written, the unit of intensity, a text that states it."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import scan_columns

if TYPE_CHECKING:
    from laspy import LasData
    from laspy.vlrs.vlr import VLR

FULL = 65535  # the largest intensity that LAS holds, and the factor of fractions of 1
_LOOKED_AT = 4  # scans of a topic by which its unit is told
_ABOVE = 0.1  # share of values above 1 from which they are counts; a few are strays of a fraction


def intensity_factors(archive: Archive) -> dict[str, int]:
    """Return by topic (empty for files) what intensities are multiplied by for LAS: 1 where they are counts, else 65535.

    Integers are counts, and so are numbers of which more than a few are above 1. It is decided once for an
    archive, by scans from all over it, so that no two files of it differ.
    """
    found: dict[str, list[NDArray[np.float64]]] = {}
    counts: set[str] = set()
    for scan in _spread(archive):
        topic = topic_of(scan)
        values = scan_columns(scan).get("intensity")
        if values is None:
            continue
        if values.dtype.kind in "iu":
            counts.add(topic)
        found.setdefault(topic, []).append(values[np.isfinite(values)].astype(np.float64))
    joined = {topic: np.concatenate(values) for topic, values in found.items()}
    return {
        topic: 1 if topic in counts or (values > 1).sum() > _ABOVE * len(values) else FULL
        for topic, values in joined.items()
    }


def topic_of(scan: Scan) -> str:
    """The topic that a scan came on; empty for a file."""
    return scan.cloud.topic if scan.cloud is not None else ""


def las_intensity(values: NDArray[np.generic], factor: int) -> tuple[NDArray[np.uint16], int]:
    """Return intensities ``(N,)`` times ``factor``, rounded to what LAS holds, and how many of them it does not hold.

    Those are negative, not finite, or too large, and become the nearest that it holds; NaN becomes 0.
    """
    with np.errstate(over="ignore"):
        wide = values.astype(np.float64) * factor
    whole = np.rint(np.nan_to_num(np.clip(wide, 0, FULL))).astype(np.uint16)
    return whole, int(np.count_nonzero(~((wide >= 0) & (wide <= FULL))))


def laz_of(las: LasData) -> bytes:
    """Return the file; whoever writes it names it when the disk is full, which lazrs does not."""
    file = BytesIO()
    las.write(file, do_compress=True)
    return file.getvalue()


def text_record(*lines: str) -> VLR:
    """A text area description, the record in which LAS keeps what its header has no place for."""
    from laspy.vlrs.vlr import VLR

    return VLR("LASF_Spec", 3, "Text area", "\n".join(lines).encode())


def intensity_text(factor: int, kind: np.dtype[np.generic], exact: str | None) -> str:
    """Say what unit intensities are in; ``exact`` names the dimension of the recorded values."""
    unit = f"{kind.name} counts as recorded" if factor == 1 else f"{kind.name} as recorded times {factor}"
    return f"intensity: {unit}" + (f", rounded, within 0 to {FULL}; {exact} is exact" if exact else "")


def _spread(archive: Archive) -> Iterator[Scan]:
    """A few scans of each topic, from its first to its last; where a log has several, names start with the topic."""
    places: dict[str, list[int]] = {}
    for place, name in enumerate(archive.names):
        places.setdefault(name.rpartition("-")[0], []).append(place)
    chosen = {
        of[at]
        for of in places.values()
        for at in np.linspace(0, len(of) - 1, _LOOKED_AT).round().astype(int).tolist()
    }
    for place in sorted(chosen):
        yield archive[place]


def coordinate_system(name: str) -> Any:
    """Return the coordinate system that PROJ knows by a name such as ``EPSG:25832``.

    Raises:
        UsageError: it knows none of it.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(name)
    except CRSError as error:
        raise UsageError(f"--crs {name}: not known to PROJ; name it as in EPSG:25832") from error
