"""Write decoded scans in the formats of others: KITTI folders, MCAP PointCloud2, ROS 1 bags, PLY, LAZ."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.log_export import to_bag, to_mcap
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import point_rows, scan_columns
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

_PLY = dict(
    zip(
        ("f4", "f8", "i1", "u1", "i2", "u2", "i4", "u4"),
        ("float", "double", "char", "uchar", "short", "ushort", "int", "uint"),
        strict=True,
    )
)
LAZ_SCALE = 0.0001  # metres; LAZ holds integers, so it rounds
LAZ_REACH = LAZ_SCALE * 2**30
_FAR = 1e9  # metres; beyond the Earth, and its coordinate systems


def to_kitti(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/sequences/SEQ/velodyne/NAME.bin``, the files that the archive was made from."""
    folder = out / "sequences" / archive.sequence / "velodyne"
    for scan in scans:
        path = folder / f"{scan.name}.bin"
        with atomic(path) as stream:
            wide = archive.config.get("columns", 4) > 4  # then a scan's rows are those of its cloud
            stream.write(point_rows(scan).tobytes() if wide else points_to_bytes(scan.points, scan.intensity))
        yield path


def to_ply(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.ply`` (binary): all fields with their types, and the class of each point."""
    for scan in scans:
        path = out / archive.sequence / f"{scan.name}.ply"
        columns = scan_columns(scan)
        if scan.classes is not None:
            columns["class"] = scan.classes
        rows = np.empty(
            len(scan), [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
        )
        for name, values in columns.items():
            rows[name] = values
        header = "".join(f"property {_PLY[v.dtype.str[1:]]} {name}\n" for name, v in columns.items())
        with atomic(path) as stream:
            text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(scan)}\n{header}end_header\n"
            stream.write(text.encode() + rows.tobytes())
        yield path


def to_laz(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.laz``: coordinates rounded to 0.1 mm, intensity times 65535, class as user data.

    Points that LAZ cannot hold (NaN, or far from all others) are left out.
    """
    try:
        import laspy
    except ImportError as error:
        raise UsageError(
            "--to laz needs laspy and lazrs: pip install 'salpcc-pipeline[baselines]'"
        ) from error
    for scan in scans:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, LAZ_SCALE)
        columns = scan_columns(scan)
        xyz = np.column_stack([columns[axis].astype(np.float64) for axis in "xyz"])
        finite = np.asarray((np.abs(xyz) < _FAR).all(axis=1))  # NaN is not
        if len(xyz[finite]) and np.abs(xyz[finite]).max() > LAZ_REACH:
            header.offsets = np.rint(np.median(xyz[finite], axis=0))
            finite &= np.asarray((np.abs(xyz - header.offsets) < LAZ_REACH).all(axis=1))
        las = laspy.LasData(header)
        las.xyz = xyz[finite]
        las.intensity = _unit(scan.intensity[finite])
        if scan.classes is not None:
            las.user_data = scan.classes[finite]
        path = out / archive.sequence / f"{scan.name}.laz"
        with atomic(path) as stream:
            las.write(stream, do_compress=True)
        yield path


def _unit(intensity: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Intensities of 0 to 1 over LAS's range; larger ones are counts and stay as they are."""
    if np.nanmax(intensity, initial=0) > 1:
        counts: NDArray[np.uint16] = np.nan_to_num(np.clip(np.rint(intensity), 0, 65535)).astype(np.uint16)
        return counts
    scaled = np.nan_to_num(np.clip(intensity.astype(np.float64), 0, 1)) * 65535
    return np.rint(scaled).astype(np.uint16)


EXPORTS: dict[str, Callable[[Archive, Iterator[Scan], Path], Iterator[Path]]] = {
    "kitti": to_kitti,
    "mcap": to_mcap,
    "bag": to_bag,
    "ply": to_ply,
    "laz": to_laz,
}
