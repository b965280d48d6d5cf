"""Write decoded scans as LAZ 1.4, and say what its integers cannot hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.beside import tell_what_stays
from salpcc.pipeline.export.gps_time import adjusted_gps_time, is_calendar_time
from salpcc.pipeline.export.las import (
    coordinate_system,
    intensity_factors,
    intensity_text,
    las_intensity,
    laz_of,
    text_record,
    topic_of,
)
from salpcc.pipeline.export.new_files import write_new
from salpcc.pipeline.export.tell import Tell, in_silence
from salpcc.schemas.extras import require
from salpcc.schemas.labels import ASPRS_OF_CLASS, CLASSES
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import add_column, free_name, scan_columns

if TYPE_CHECKING:
    import laspy

SCALE = 0.0001  # metres; LAZ holds integers, so it rounds
REACH = SCALE * 2**30
_FAR = 1e9  # metres; beyond the Earth, and its coordinate systems
_LONGEST = 32  # bytes of a dimension's name
_AS_THEY_ARE = (np.uint8, np.uint16)  # types of intensity that LAS holds


def to_laz(
    archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence, crs: str | None = None
) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.laz``: places rounded to 0.1 mm, every other field as an extra dimension.

    Intensities are counts, or fractions of 1 times 65535 (:func:`~salpcc.pipeline.export.las.intensity_factors`); what LAS
    cannot hold exactly is in ``recorded_intensity``, too. Classes are in ``classification`` by the codes of ASPRS and
    in ``user_data`` by ours. GPS time is that of the scan. A text record in each file states all that. Points
    without a place (NaN, or far from all others) are left out.

    Raises:
        UsageError: ``crs`` is no coordinate system, other points are there, or the extra ``map`` is missing.
    """
    require("map", "--to laz")
    system = coordinate_system(crs) if crs else None
    factors = intensity_factors(archive)
    told: set[str] = set()
    wrong = left_out = 0
    for scan in scans:
        file = _file(archive, scan, factors.get(topic_of(scan), 1), system)
        if file.unit not in told:
            tell(file.unit)
            told.add(file.unit)
        wrong, left_out = wrong + file.wrong, left_out + file.left_out
        path = out / archive.sequence / f"{scan.name}.laz"
        write_new(path, laz_of(file.las), "points are")
        yield path
    if wrong:
        tell(
            f"intensity: {wrong} negative, not finite or too large for LAS; recorded_intensity has them as they are"
        )
    if left_out:
        tell(f"{left_out} points are left out: LAS holds no NaN, and nothing far from all the others")
    tell_what_stays(archive, "laz", tell)


@dataclass(frozen=True)
class _File:
    """The LAZ of a scan, and what is to be told: the unit, how many intensities and points LAS does not hold."""

    las: laspy.LasData
    unit: str
    wrong: int
    left_out: int


def _file(archive: Archive, scan: Scan, factor: int, system: Any) -> _File:
    import laspy
    from laspy.header import GpsTimeType

    columns = scan_columns(scan)
    if scan.labels is not None:
        add_column(columns, "label", scan.labels)
    xyz = np.column_stack([columns.pop(axis).astype(np.float64) for axis in "xyz"])
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.creation_date = date(1970, 1, 1) + timedelta(
        seconds=scan.time // 10**9
    )  # not the day of the export
    header.scales, header.offsets = np.full(3, SCALE), _offset(xyz)
    kept = np.asarray((np.abs(xyz - header.offsets) < REACH).all(axis=1))  # NaN is not
    names = _names(columns, {*header.point_format.dimension_names, *"xyz"})
    header.add_extra_dims([laspy.ExtraBytesParams(name, columns[of].dtype) for of, name in names.items()])
    calendar = is_calendar_time(scan.time)
    header.global_encoding.gps_time_type = GpsTimeType.STANDARD if calendar else GpsTimeType.WEEK_TIME
    if system is not None:
        header.add_crs(system)

    las = laspy.LasData(header)
    las.xyz = xyz[kept]
    las.return_number = np.ones(len(las.xyz), np.uint8)
    las.number_of_returns = np.ones(len(las.xyz), np.uint8)
    las.gps_time = np.full(len(las.xyz), adjusted_gps_time(scan.time) if calendar else scan.time / 1e9)
    if scan.offset is not None:
        las.gps_time += scan.offset[kept] / 1e9
    if scan.classes is not None:
        las.classification, las.user_data = ASPRS_OF_CLASS[scan.classes][kept], scan.classes[kept]
    for of, name in names.items():
        las[name] = columns[of][kept]
    unit, wrong = "intensity: none recorded", 0
    if "intensity" in columns:
        las.intensity, wrong = las_intensity(columns["intensity"][kept], factor)
        unit = intensity_text(factor, columns["intensity"].dtype, names.get("intensity"))
    clock = "adjusted standard GPS time, from UTC" if calendar else "seconds since the recording began"
    classes = ", ".join(f"{i} {c.name}" for i, c in enumerate(CLASSES))
    about = text_record(
        f"{archive.sequence}, scan {scan.name}, frame {scan.frame_id}, {scan.time} ns {topic_of(scan)}",
        unit,
        f"gps_time: of the {'scan' if scan.offset is None else 'point'}, {clock}",
        f"user_data: {'no classes' if scan.classes is None else classes}",
    )
    header.vlrs.append(about)
    return _File(las, unit, wrong, int(np.count_nonzero(~kept)))


def _offset(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return whole metres ``(3,)`` near the points; zeros where integers reach them from there."""
    sound = xyz[np.asarray((np.abs(xyz) < _FAR).all(axis=1))]
    near = not len(sound) or np.abs(sound).max() < REACH
    return np.zeros(3) if near else np.rint(np.median(sound, axis=0))


def _names(columns: dict[str, NDArray[Any]], standard: set[str]) -> dict[str, str]:
    """Name the extra dimension of each field: as the field, or ``recorded_…`` where LAS has such a name of its own.

    Intensities of a type that LAS holds need none.
    """
    wanted = {of: f"recorded_{of}" if of in standard else of for of in columns}
    if "intensity" in columns and columns["intensity"].dtype in _AS_THEY_ARE:
        del wanted["intensity"]
    taken = standard | {name for name in wanted.values() if len(name) <= _LONGEST}
    names: dict[str, str] = {}
    for of, name in wanted.items():
        fits = len(name) <= _LONGEST and name not in names.values()
        names[of] = name if fits else free_name(name[: _LONGEST - 4], taken)
    return names
