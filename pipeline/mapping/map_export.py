"""Write a map: tiles as LAZ, PLY and PCD, the whole as PointCloud2 messages in an MCAP."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from salpcc.pipeline.export.copc import copc_of
from salpcc.pipeline.export.las import coordinate_system, intensity_text, las_intensity, laz_of, text_record
from salpcc.pipeline.export.ply import ply_of
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.schemas.files import atomic
from salpcc.schemas.labels import ASPRS_OF_CLASS, CLASSES
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.stages.mapping.voxel import SYNTHETIC, Voxels

F64 = NDArray[np.float64]

LAZ_SCALE = 0.001  # metres; LAZ holds integers
MAP_TOPIC, MAP_FRAME = "/map", "map"
_FIELDS = (
    ("x", 0, 7, 1),
    ("y", 4, 7, 1),
    ("z", 8, 7, 1),
    ("intensity", 12, 7, 1),
    ("count", 16, 6, 1),
    ("class", 20, 2, 1),
)
_ROW = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("count", "<u4"), ("class", "u1")]
)
_PCD_KINDS = {"f": "F", "u": "U"}


def to_laz(voxels: Voxels, corner: F64, frame: Frame, path: Path) -> None:
    """Write LAZ 1.4: places in the frame of the poses to 1 mm, intensity times the factor and as it is, ASPRS classification.

    Our class is user data; ``count`` says how many points were fused.
    """
    with_columns(voxels, corner, frame, path, {})


def to_copc(voxels: Voxels, corner: F64, frame: Frame, path: Path) -> None:
    """Write the same as :func:`to_laz`, as COPC."""
    las = _las(voxels, corner, frame, {})
    with atomic(path) as stream:
        stream.write(copc_of(las))


def with_columns(
    voxels: Voxels, corner: F64, frame: Frame, path: Path, columns: Mapping[str, NDArray[Any]], *texts: str
) -> None:
    """Write LAZ as :func:`to_laz` does, with more extra dimensions ``(M,)`` by name, and texts that say what they are."""
    las = _las(voxels, corner, frame, columns, *texts)
    with atomic(path) as stream:
        stream.write(laz_of(las))


def _las(
    voxels: Voxels, corner: F64, frame: Frame, columns: Mapping[str, NDArray[Any]], *texts: str
) -> laspy.LasData:
    origin, factor = np.array(frame.origin), frame.factor
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, LAZ_SCALE), np.floor(corner + origin)
    if frame.crs:
        header.add_crs(coordinate_system(frame.crs))
    header.add_extra_dim(laspy.ExtraBytesParams("count", np.uint32, "points fused"))
    header.add_extra_dim(laspy.ExtraBytesParams("mean_intensity", np.float32))
    for name, values in columns.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype))
    header.vlrs.append(text_record(intensity_text(factor, np.dtype(np.float32), "mean_intensity"), *texts))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (voxels.xyz + origin).T
    las.intensity, _ = las_intensity(voxels.intensity, factor)
    las.mean_intensity = voxels.intensity
    las.classification = _ASPRS[voxels.classes]
    las.user_data = voxels.classes
    las.synthetic = (voxels.classes == SYNTHETIC).astype(np.uint8)
    las.count = voxels.count
    for name, values in columns.items():
        las[name] = values
    return las


def to_ply(voxels: Voxels, corner: F64, frame: Frame, path: Path) -> None:
    """Write a binary PLY, float32 places in the map's frame, whose origin is a comment."""
    rows = _rows(voxels)
    columns = {name: rows[name] for name in rows.dtype.names or ()}
    with atomic(path) as stream:
        stream.write(ply_of(columns, [_origin_text(frame)]))


def to_pcd(voxels: Voxels, corner: F64, frame: Frame, path: Path) -> None:
    """Write a binary PCD 0.7, float32 places in the map's frame, whose origin is a comment."""
    rows = _rows(voxels)
    names = rows.dtype.names or ()
    kinds = [rows.dtype[name] for name in names]
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\n# {_origin_text(frame)}\nVERSION 0.7\n"
        f"FIELDS {' '.join(names)}\nSIZE {' '.join(str(kind.itemsize) for kind in kinds)}\n"
        f"TYPE {' '.join(_PCD_KINDS[kind.kind] for kind in kinds)}\nCOUNT {' '.join('1' for _ in kinds)}\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
    )
    with atomic(path) as stream:
        stream.write(header.encode() + rows.tobytes())


# Each takes a tile's entries, its corner, the map's frame and the path.
WRITERS: dict[str, Callable[[Voxels, F64, Frame, Path], None]] = {
    "laz": to_laz,
    "copc": to_copc,
    "ply": to_ply,
    "pcd": to_pcd,
}
FORMATS = (*WRITERS, "mcap")


def tile_file(out: Path, name: str, form: str) -> Path:
    """Return the file of a tile in one of the formats of :data:`WRITERS`."""
    return out / "tiles" / f"{name}.{'copc.laz' if form == 'copc' else form}"


def to_mcap(tiles: Iterable[Voxels], frame: Frame, path: Path) -> None:
    """Write one ``sensor_msgs/msg/PointCloud2`` a tile on ``/map``, frame ``map``; one tile is held at a time.

    The origin of that frame is metadata ``map``.
    """
    with atomic(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="salpcc-pipeline")
        schema = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        channel = writer.register_channel(MAP_TOPIC, "cdr", schema, {"offered_qos_profiles": ""})
        x, y, z = map(repr, frame.origin)
        writer.add_metadata("map", {"origin_x": x, "origin_y": y, "origin_z": z, "crs": frame.crs or ""})
        for place, voxels in enumerate(tiles):
            rows = _rows(voxels)
            message = CloudMessage(
                0, MAP_FRAME, len(rows), rows.tobytes(), point_step=_ROW.itemsize, fields=_FIELDS
            )
            writer.add_message(channel, place, message.to_cdr(), place, place)
        writer.finish()


def _origin_text(frame: Frame) -> str:
    return (
        "origin " + " ".join(map(repr, frame.origin)) + " metres" + (f" in {frame.crs}" if frame.crs else "")
    )


def _rows(voxels: Voxels) -> NDArray[np.void]:
    rows = np.empty(len(voxels), _ROW)
    for axis, name in enumerate("xyz"):
        rows[name] = voxels.xyz[:, axis]
    rows["intensity"], rows["count"], rows["class"] = voxels.intensity, voxels.count, voxels.classes
    return rows


_ASPRS = np.ones(256, np.uint8)
_ASPRS[: len(CLASSES)] = ASPRS_OF_CLASS
_ASPRS[SYNTHETIC] = 2
