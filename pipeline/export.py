"""Write decoded scans in the formats of others: KITTI folders, MCAP PointCloud2, PLY, LAZ."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

LAZ_SCALE = 0.0001  # metres; LAZ holds integers, so it rounds


def to_kitti(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/sequences/SEQ/velodyne/NAME.bin``, the files that the archive was made from."""
    folder = out / "sequences" / archive.sequence / "velodyne"
    for scan in scans:
        path = folder / f"{scan.name}.bin"
        with atomic(path) as stream:
            stream.write(points_to_bytes(scan.points, scan.intensity))
        yield path


def to_mcap(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/SEQ.mcap`` with one ``sensor_msgs/msg/PointCloud2`` per scan, bits unchanged."""
    path = out / f"{archive.sequence}.mcap"
    with atomic(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="salpcc-pipeline")
        schema = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        channel = writer.register_channel("/points", "cdr", schema, {"offered_qos_profiles": ""})
        for place, scan in enumerate(scans):
            data = points_to_bytes(scan.points, scan.intensity)
            dense = bool(np.isfinite(scan.points).all())
            message = CloudMessage(scan.time, scan.frame_id, len(scan), data, is_dense=dense)
            writer.add_message(channel, scan.time, message.to_cdr(), scan.time, place)
        writer.finish()
    yield path


def to_ply(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.ply`` (binary, float32), with the class of each point where there is one."""
    for scan in scans:
        path = out / archive.sequence / f"{scan.name}.ply"
        columns = [(name, "<f4") for name in ("x", "y", "z", "intensity")]
        if scan.classes is not None:
            columns.append(("class", "u1"))
        rows = np.empty(len(scan), columns)
        for axis, name in enumerate("xyz"):
            rows[name] = scan.points[:, axis]
        rows["intensity"] = scan.intensity
        if scan.classes is not None:
            rows["class"] = scan.classes
        kinds = {"<f4": "float", "u1": "uchar"}
        header = "".join(f"property {kinds[kind]} {name}\n" for name, kind in columns)
        with atomic(path) as stream:
            text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(scan)}\n{header}end_header\n"
            stream.write(text.encode() + rows.tobytes())
        yield path


def to_laz(archive: Archive, scans: Iterator[Scan], out: Path) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.laz``: coordinates rounded to 0.1 mm, intensity times 65535, class as user data."""
    try:
        import laspy
    except ImportError as error:
        raise UsageError(
            "--to laz needs laspy and lazrs: pip install 'salpcc-pipeline[baselines]'"
        ) from error
    for scan in scans:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, LAZ_SCALE)
        header.offsets = np.zeros(3)
        las = laspy.LasData(header)
        finite = np.isfinite(scan.points).all(axis=1)
        las.xyz = scan.points[finite].astype(np.float64)
        las.intensity = _unit(scan.intensity[finite])
        if scan.classes is not None:
            las.user_data = scan.classes[finite]
        path = out / archive.sequence / f"{scan.name}.laz"
        with atomic(path) as stream:
            las.write(stream, do_compress=True)
        yield path


def _unit(intensity: NDArray[np.float32]) -> NDArray[np.uint16]:
    scaled = np.nan_to_num(np.clip(intensity.astype(np.float64), 0, 1)) * 65535
    return np.rint(scaled).astype(np.uint16)


EXPORTS: dict[str, Callable[[Archive, Iterator[Scan], Path], Iterator[Path]]] = {
    "kitti": to_kitti,
    "mcap": to_mcap,
    "ply": to_ply,
    "laz": to_laz,
}
