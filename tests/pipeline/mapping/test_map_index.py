"""Tiles as COPC, and their index: readers of either find every point with its values."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.copc import Bounds

from salpcc.pipeline.export.copc import copc_of
from salpcc.pipeline.mapping.make_map import make_map
from salpcc.pipeline.mapping.map_index import write_index
from salpcc.pipeline.mapping.map_request import MapRequest


def cloud(xyz: np.ndarray) -> laspy.LasData:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(xyz.min(axis=0))
    header.add_extra_dim(laspy.ExtraBytesParams("number", np.uint32))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    las.number = np.arange(len(xyz))
    las.gps_time = np.linspace(5, 6, len(xyz))
    return las


@pytest.mark.parametrize(
    "xyz",
    [
        np.random.default_rng(0).uniform([4e5, 5e6, 0], [4e5 + 60, 5e6 + 40, 5], (60_000, 3)),
        np.zeros((1, 3)),
        np.full((300, 3), 7.0),  # all in one place: no level parts them
        np.column_stack([np.linspace(0, 100, 5000), np.zeros((5000, 2))]),
    ],
    ids=["block", "one point", "one place", "line"],
)
def test_every_point_is_in_one_node_that_holds_its_place(xyz: np.ndarray) -> None:
    las = cloud(xyz)
    plain = laspy.read(io.BytesIO(data := copc_of(las)))
    order = np.argsort(plain.number)
    for name in ("X", "Y", "Z", "number", "gps_time"):
        np.testing.assert_array_equal(np.asarray(plain[name])[order], np.asarray(las[name]))
    np.testing.assert_array_equal(plain.header.maxs, las.header.maxs)
    reader = laspy.CopcReader(io.BytesIO(data))
    info = reader.copc_info
    assert (info.gps_min, info.gps_max) == (las.gps_time.min(), las.gps_time.max())
    corner = info.center - info.halfsize
    np.testing.assert_allclose(corner, las.header.mins, atol=1e-6)
    seen = []
    for level in range(11):
        points = reader.query(level=level)
        cells = np.floor(
            (np.column_stack([points.x, points.y, points.z]) - corner) / (info.spacing / (1 << level))
        )
        if level < 10:  # a viewer may draw a level as it is: no two points of it share a cell
            assert len(np.unique(cells, axis=0)) == len(cells)
        seen.append(np.asarray(points.number))
    np.testing.assert_array_equal(np.sort(np.concatenate(seen)), np.arange(len(xyz)))
    low, high = np.quantile(xyz, 0.3, axis=0), np.quantile(xyz, 0.6, axis=0)
    counts = np.column_stack([las.X, las.Y, las.Z])  # what a reader compares
    first, last = (np.rint((corner - las.header.offsets) / 0.001) for corner in (low, high))
    inside = ((counts >= first) & (counts <= last)).all(axis=1)
    assert len(reader.query(bounds=Bounds(low, high))) == np.count_nonzero(inside)


def test_copc_tiles_are_the_laz_tiles_and_both_are_in_an_index(
    request_: Callable[..., MapRequest], made: Path, tmp_path: Path
) -> None:
    shutil.copytree(made / "shards", tmp_path / "shards")
    asked = request_(tmp_path, formats=["copc", "laz"])
    summary = make_map(asked)
    index = json.loads((tmp_path / "map.vpc").read_text())
    assert index["type"] == "FeatureCollection" and len(index["features"]) == len(summary["tiles"])
    total = 0
    for item in index["features"]:
        properties = item["properties"]
        copc = tmp_path / item["assets"]["data"]["href"]
        assert copc.name == f"{item['id']}.copc.laz" and item["stac_version"] == "1.0.0"
        ours, plain = laspy.read(copc), laspy.read(tmp_path / "tiles" / f"{item['id']}.laz")
        np.testing.assert_array_equal(np.sort(ours.points.array), np.sort(plain.points.array))
        assert [v.record_data_bytes() for v in ours.vlrs if v.record_id == 3] == [
            v.record_data_bytes() for v in plain.vlrs if v.record_id == 3
        ]
        assert properties["pc:count"] == len(ours)
        np.testing.assert_allclose(
            properties["proj:bbox"], [*ours.xyz.min(axis=0), *ours.xyz.max(axis=0)], atol=1e-9
        )
        sizes = {row["name"]: (row["type"], row["size"]) for row in properties["pc:schemas"]}
        assert sizes["X"] == ("floating", 8) and sizes["Intensity"] == ("unsigned", 2)
        assert sizes["count"] == ("unsigned", 4) and sizes["mean_intensity"] == ("floating", 4)
        assert item["bbox"] == properties["proj:bbox"] and properties["proj:wkt2"] == ""
        total += len(ours)
    assert total == summary["voxels"]["kept"]
    assert make_map(asked) == summary  # complete: left as it is
    make_map(replace(asked, formats=["ply"]))
    assert not (tmp_path / "map.vpc").exists() and {p.suffix for p in (tmp_path / "tiles").glob("x*")} == {
        ".ply"
    }


def test_an_index_of_a_country_says_where_on_the_globe(tmp_path: Path) -> None:
    (tmp_path / "tiles").mkdir()
    path = tmp_path / "tiles" / "a.laz"
    cloud(np.array([[455_000.0, 5_428_000.0, 110.0], [455_050.0, 5_428_050.0, 120.0]])).write(path)
    write_index(tmp_path, [path], "EPSG:25832")
    [item] = json.loads((tmp_path / "map.vpc").read_text())["features"]
    west, south, low, east, north, high = item["bbox"]
    assert 8.38 < west < east < 8.39 and 49.0 < south < north < 49.01 and (low, high) == (110, 120)
    assert item["properties"]["proj:wkt2"].startswith("PROJCRS")
    ring = item["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1] and len(ring) == 5
