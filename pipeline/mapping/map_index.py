"""The index of a map's tiles: a virtual point cloud (.vpc), the STAC items of all tiles, by which QGIS and PDAL open them as one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from salpcc.pipeline.export.las import coordinate_system
from salpcc.schemas.files import write_json

INDEX = "map.vpc"
_EXTENSIONS = (
    "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json",
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json",
)
_KINDS = {"f": "floating", "i": "signed", "u": "unsigned"}
_PLACE = {"name": "", "type": "floating", "size": 8}  # X, Y and Z, as readers give them


def write_index(out: Path, tiles: Sequence[Path], crs: str | None) -> None:
    """Write ``OUT/map.vpc`` of LAZ or COPC tiles below ``out``; without a coordinate system, places stand as they are.

    What it says of a tile, it reads from the header of its file.
    """
    features = [_item(out, path, crs) for path in tiles]
    write_json(out / INDEX, {"type": "FeatureCollection", "features": features})


def _item(out: Path, path: Path, crs: str | None) -> dict[str, Any]:
    with laspy.open(path) as opened:
        header = opened.header
    box = [*map(float, header.mins), *map(float, header.maxs)]
    globe = _on_the_globe(box, crs)
    made = header.creation_date
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": list(_EXTENSIONS),
        "id": path.name.partition(".")[0],
        "geometry": _rectangle(globe),
        "bbox": globe,
        "properties": {
            "datetime": f"{made:%Y-%m-%d}T00:00:00Z" if made else None,
            "pc:count": int(header.point_count),
            "pc:type": "lidar",
            "pc:encoding": "application/vnd.laszip+copc"
            if path.name.endswith(".copc.laz")
            else "application/vnd.laszip",
            "pc:schemas": _schemas(header),
            "proj:wkt2": coordinate_system(crs).to_wkt() if crs else "",
            "proj:geometry": _rectangle(box),
            "proj:bbox": box,
        },
        "links": [],
        "assets": {"data": {"href": f"./{path.relative_to(out).as_posix()}", "roles": ["data"]}},
    }


def _schemas(header: laspy.LasHeader) -> list[dict[str, Any]]:
    rows = [_PLACE | {"name": axis} for axis in "XYZ"]
    for dimension in header.point_format.dimensions:
        if dimension.name not in ("X", "Y", "Z"):
            kind = np.dtype("u1") if dimension.dtype is None else np.dtype(dimension.dtype)  # of a few bits
            name = (
                dimension.name
                if not dimension.is_standard
                else "".join(map(str.capitalize, dimension.name.split("_")))
            )
            rows.append({"name": name, "type": _KINDS[kind.kind], "size": kind.itemsize})
    return rows


def _rectangle(box: Sequence[float]) -> dict[str, Any]:
    """Return the polygon, seen from above, of a box x0, y0, z0, x1, y1, z1, counter-clockwise."""
    x0, y0, z0, x1, y1, _ = box
    corners = [[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0], [x0, y0, z0]]
    return {"type": "Polygon", "coordinates": [corners]}


def _on_the_globe(box: Sequence[float], crs: str | None) -> list[float]:
    """Return a box in degrees of longitude and latitude, as STAC wants it."""
    if crs is None:
        return list(box)
    from pyproj import Transformer

    to_degrees = Transformer.from_crs(coordinate_system(crs), "EPSG:4326", always_xy=True)
    x0, y0, z0, x1, y1, z1 = box
    west, south, east, north = to_degrees.transform_bounds(x0, y0, x1, y1)
    return [west, south, z0, east, north, z1]
