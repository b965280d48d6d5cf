"""Maps: from a small simulated drive to tiles, the same however it is cut; wrong poses are told; Table V."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from plyfile import PlyData
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.edit.cut import Selection, cut
from salpcc.pipeline.encode import encode_scans
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.mapping import make_map as map_module
from salpcc.pipeline.mapping import map_scans, map_submaps, map_tiles, map_track
from salpcc.pipeline.mapping.localise import LocaliseRequest, localise
from salpcc.pipeline.mapping.make_map import make_map
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SalpccError, UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.report.downstream import registration_figures
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.untwist import untwist
from salpcc.stages.mapping.drive.poses import read_poses
from salpcc.stages.mapping.gather import gather
from salpcc.stages.mapping.voxel import keys_of

from .conftest import CONFIG, SCANS, SEQUENCE


def test_map_is_clean_and_whole(made: Path) -> None:
    rows = json.loads((made / "map.json").read_text())["quality"]
    figures = {(row["cleaner"], row["truth"]): row for row in rows}
    ours, none = figures["ours", "moving"], figures["none", "moving"]
    assert ours["sa"] > 0.99 and ours["da"] > 0.98 and ours["f1"] > 0.98
    assert none["sa"] == 1.0 and none["da"] == 0.0
    assert (
        figures["ours, carving only", "moving"]["da"] > 0.5
    )  # ten scans see through what moved, without a label
    assert figures["ours, classes only", "movable"]["da"] > 0.95


def test_all_formats_hold_the_same_points(made: Path) -> None:
    summary_ = json.loads((made / "map.json").read_text())
    total = 0
    for tile in summary_["tiles"]:
        las = laspy.read(made / "tiles" / f"{tile}.laz")
        pcd = (made / "tiles" / f"{tile}.pcd").read_bytes()
        ply = (made / "tiles" / f"{tile}.ply").read_bytes()
        assert f"POINTS {len(las)}\n".encode() in pcd and f"vertex {len(las)}\n".encode() in ply
        rows = np.frombuffer(ply[ply.index(b"end_header\n") + 11 :], np.uint8).reshape(len(las), 21)
        assert pcd.endswith(rows.tobytes())
        places = rows[:, :12].copy().view("<f4")
        np.testing.assert_allclose(np.asarray(las.xyz), places, atol=6e-4)
        np.testing.assert_array_equal(np.asarray(las.synthetic) == 1, np.asarray(las.user_data) == 255)
        np.testing.assert_array_equal(las.intensity, np.rint(65535 * las.mean_intensity.astype(np.float64)))
        np.testing.assert_array_equal(np.asarray(las.count) == 0, np.asarray(las.user_data) == 255)
        total += len(las)
    assert total == summary_["voxels"]["kept"] > 10000
    with open(made / "map.mcap", "rb") as stream:
        messages = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert sum(message.decoded_message.width for message in messages) == total
    assert {message.channel.topic for message in messages} == {"/map"}
    assert len(list((made / "pictures").glob("*.png"))) == 4


def test_map_of_the_decoded_is_map_of_the_originals(archive: Path, root: Path, poses: Path) -> None:
    refs = SOURCES["simulated"].scans(root, SEQUENCE)[:3]
    placed = read_poses(poses)[:3]
    still = np.zeros((3, 6))
    originals = gather((SOURCES["simulated"].read(ref, True) for ref in refs), placed, still, CONFIG)
    decoded = gather(Archive.open(archive)[:3], placed, still, CONFIG)
    assert np.array_equal(originals.voxels.xyz, decoded.voxels.xyz)
    assert np.array_equal(originals.voxels.classes, decoded.voxels.classes)
    assert np.array_equal(originals.voxels.count, decoded.voxels.count)


def test_what_was_removed_says_why(
    request_: Callable[..., MapRequest], made: Path, root: Path, tmp_path: Path
) -> None:
    """Every entry that is not in the map is in its tiles, with a reason and the scans that speak for and against it."""
    shutil.copytree(made / "shards", tmp_path / "shards")
    summary = make_map(request_(tmp_path, explain=True))
    removed = [laspy.read(path) for path in sorted((tmp_path / "removed").glob("*.laz"))]
    reason, through, met, score = (
        np.concatenate([np.asarray(las[name]) for las in removed])
        for name in ("reason", "through", "met", "score")
    )
    assert np.count_nonzero(reason & 1) == summary["voxels"]["carved"] > 0
    assert np.count_nonzero(reason & 6) == summary["voxels"]["dropped"] > 0
    seen_through = reason & 1 == 1
    assert (through[seen_through] >= 2).all() and (through >= 2 * met)[seen_through].all()
    assert (score[seen_through] > 0.6).all() and (score[~seen_through] == 1).all()
    assert (tmp_path / "pictures" / "removed.png").stat().st_size > 1000
    make_map(request_(tmp_path))  # another map: what explains the older one is gone
    assert not [*(tmp_path / "removed").glob("*"), *(tmp_path / "pictures").glob("removed*")]


def test_tiles_do_not_change_the_map(request_: Callable[..., MapRequest], tmp_path: Path) -> None:
    one = make_map(request_(tmp_path / "a", config=CONFIG.model_copy(update={"tile": 200.0})))
    many = make_map(request_(tmp_path / "b"))
    assert len(many["tiles"]) > len(one["tiles"])
    assert many["voxels"] == one["voxels"]
    assert many["points_in_map"] == one["points_in_map"]


def test_interrupted_map_goes_on_and_a_made_one_is_left(
    request_: Callable[..., MapRequest], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = request_(tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(map_module, "write_whole", lambda *_: (_ for _ in ()).throw(OSError("disk")))
        with pytest.raises(OSError, match="disk"):
            make_map(asked)
    with monkeypatch.context() as no_work:
        no_work.setattr(map_scans, "decode_scans", None)
        no_work.setattr(map_track, "follow", None)
        no_work.setattr(map_tiles, "build", None)
        first = make_map(asked)
        assert make_map(asked) == first
    (tmp_path / "tiles" / f"{first['tiles'][0]}.ply").unlink()
    again = make_map(asked)
    assert again["voxels"] == first["voxels"]
    assert (tmp_path / "tiles" / f"{first['tiles'][0]}.ply").is_file()


def test_damaged_shard_is_told_and_made_again(
    request_: Callable[..., MapRequest], made: Path, tmp_path: Path
) -> None:
    shutil.copytree(made / "shards", tmp_path / "shards")
    shutil.rmtree(tmp_path / "shards" / SEQUENCE / "tile")
    shard = next((tmp_path / "shards" / SEQUENCE / "submap").glob("00001-*"))
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    torn = next((tmp_path / "shards" / SEQUENCE / "thinned").glob("00000-*"))
    torn.write_bytes(torn.read_bytes()[:-9])  # as nothing reads its content, it is made again at once
    asked = request_(tmp_path)
    with pytest.raises(SalpccError, match=r"00001-.*run the same command again"):
        make_map(asked)
    assert make_map(asked)["voxels"]["kept"] > 10000


def test_public_cleaner_is_scored_beside(
    request_: Callable[..., MapRequest], made: Path, root: Path, tmp_path: Path
) -> None:
    pytest.importorskip("dufomap")
    shutil.copytree(made / "shards", tmp_path / "shards")
    rows = make_map(request_(tmp_path, against=root, rivals=["dufomap"]))["quality"]
    found = next(row for row in rows if (row["cleaner"], row["truth"]) == ("dufomap", "moving"))
    assert found["cloud"] == "source" and found["sa"] > 0.9 and found["da"] > 0.2


def test_movables_stay_where_asked(request_: Callable[..., MapRequest], made: Path, tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"keep_movable": True, "carve": False})
    everything = make_map(request_(tmp_path, config=config))["voxels"]
    clean = json.loads((made / "map.json").read_text())["voxels"]
    assert everything["carved"] == everything["dropped"] == 0
    assert everything["kept"] > clean["kept"] + clean["dropped"] - clean["filled"]


def test_odometry_finds_the_drive(request_: Callable[..., MapRequest], poses: Path, tmp_path: Path) -> None:
    make_map(request_(tmp_path, poses=[]))
    found = np.loadtxt(tmp_path / "poses.txt").reshape(-1, 3, 4)
    truth = read_poses(poses)
    way = np.linalg.norm(truth[-1, :3, 3])
    assert way > 10 and np.linalg.norm(found[-1, :, 3] - truth[-1, :3, 3]) < 0.01 * way


def test_scans_that_were_moved_already_are_not_moved_again(
    request_: Callable[..., MapRequest], made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compensated scans that do not tell how they were moved make the map of those that do."""

    def silent(*asked: object) -> Iterator[Scan]:
        return (replace(scan, motion=None) for scan in map_scans.scans_of(*asked))  # type: ignore[arg-type]

    for module in (map_track, map_submaps):
        monkeypatch.setattr(module, "scans_of", silent)
    summary = make_map(request_(tmp_path))
    told = json.loads((made / "map.json").read_text())
    assert summary["scans_moved_already"] and not told["scans_moved_already"]
    kept = told["voxels"]["kept"] - told["voxels"]["filled"]
    assert abs(summary["voxels"]["kept"] / kept - 1) < 0.01


def test_poses_of_another_drive_are_caught(
    request_: Callable[..., MapRequest], poses: Path, tmp_path: Path
) -> None:
    lines = [line.split() for line in poses.read_text().splitlines()]
    other = [" ".join([*row[:11], str(1.6 * float(row[11]))]) for row in lines]  # the same way, faster
    (tmp_path / "poses.txt").write_text("\n".join(other) + "\n")
    (tmp_path / "calib.txt").write_text(poses.with_name("calib.txt").read_text())
    with pytest.raises(SalpccError, match=r"not the poses of these scans: from scan 00000\d to .* disagree"):
        make_map(request_(tmp_path / "out", poses=[str(tmp_path / "poses.txt")]))


def test_what_cannot_be_mapped_is_named(
    request_: Callable[..., MapRequest], archive: Path, poses: Path, root: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    for lines, says in ((poses.read_text().splitlines()[:8], "none for scan 000008"), ([], "no pose in it")):
        (tmp_path / "poses.txt").write_text("\n".join(lines) + "\n")
        (tmp_path / "calib.txt").write_text(poses.with_name("calib.txt").read_text())
        with pytest.raises(SalpccError, match=says):
            make_map(request_(out, poses=[str(tmp_path / "poses.txt")]))
    with pytest.raises(UsageError, match="2 for 1 archives"):
        make_map(request_(out, poses=[str(poses)] * 2))
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(archive.read_bytes())
    with pytest.raises(SalpccError, match="scan 000000 is both in"):
        make_map(request_(out, archives=[archive, copy], poses=[]))
    with pytest.raises(UsageError, match="not found"):
        make_map(request_(out, against=tmp_path / "nowhere"))
    with pytest.raises(SalpccError, match="scan 000000 of sequence 07 has no labels"):
        bare = tmp_path / "bare" / "sequences" / SEQUENCE / "velodyne"
        bare.mkdir(parents=True)
        make_map(request_(out, against=tmp_path / "bare"))


def test_archives_of_different_sensors_are_not_one_map(
    request_: Callable[..., MapRequest], archive: Path, tmp_path: Path
) -> None:
    sensor = load_sensor("hdl64e")
    other = tmp_path / "other.json"
    other.write_text(replace(sensor, name="other", theta=sensor.theta + 1e-3).to_json())
    scan = replace(Archive.open(archive)[0], name="000100")
    path = encode_scans([scan], tmp_path / "other.mcap", "07", sensor=str(other), effort="fast")
    with pytest.raises(SalpccError, match="scan 000100 is of sensor other"):
        make_map(request_(tmp_path / "out", archives=[archive, path], poses=[]))


def test_a_map_of_counts_keeps_them(
    request_: Callable[..., MapRequest], archive: Path, tmp_path: Path
) -> None:
    scans = [replace(scan, intensity=np.rint(255 * scan.intensity)) for scan in Archive.open(archive)[:2]]
    path = encode_scans(scans, tmp_path / "counts.mcap", SEQUENCE, effort="fast")
    summary = make_map(request_(tmp_path / "map", archives=[path], formats=["laz"]))
    tiles = [laspy.read(tmp_path / "map" / "tiles" / f"{name}.laz") for name in summary["tiles"]]
    for las in tiles:
        np.testing.assert_array_equal(las.intensity, np.rint(las.mean_intensity))
        (record,) = [vlr for vlr in las.header.vlrs if vlr.record_id == 3]
        assert record.record_data_bytes().startswith(b"intensity: float32 counts as recorded")
    assert 100 < max(las.intensity.max() for las in tiles) <= 255


def test_a_map_does_not_take_the_place_of_the_poses_of_a_drive(
    request_: Callable[..., MapRequest], tmp_path: Path
) -> None:
    for name in ("poses.txt", "map.mcap"):
        (tmp_path / name).write_text("recorded")
        with pytest.raises(UsageError, match=f"its {name} is of no map, and one would replace it"):
            make_map(request_(tmp_path))
        assert (tmp_path / name).read_text() == "recorded"
        (tmp_path / name).unlink()


def test_nothing_to_register_is_told(archive: Path, root: Path, tmp_path: Path) -> None:
    one = tmp_path / "one.mcap"
    cut(archive, one, Selection(frames=(0, 1)))
    for archives, against, said in (
        ([one], root, "no two consecutive scans"),
        ([archive], one, "in maps, by --map"),
    ):
        with pytest.raises(UsageError, match=said):
            localise(LocaliseRequest(archives, against, tmp_path / "out", workers=0, quiet=True))


@pytest.mark.usefixtures("open3d")
def test_localisation_in_bit_exact_scans_is_that_in_the_originals(
    archive: Path, root: Path, tmp_path: Path
) -> None:
    request = LocaliseRequest([archive], root, tmp_path, every=8, thin=16, workers=0, quiet=True)
    rows = registration_figures(localise(request))
    by = {(row["cloud"], row["movable"], row["method"]): row for row in rows}
    assert len(by) == 8 and all(row["pairs"] == 2 for row in rows)
    for movable in (True, False):
        for method in ("point to point", "point to plane"):
            source, ours = by["source", movable, method], by["sensor", movable, method]
            assert ours["translation_m_mean"] == source["translation_m_mean"] < 1.0
            assert ours["rotation_deg_mean"] == source["rotation_deg_mean"]
            assert source["bpp"] is None and 3 < ours["bpp"] < 40


@pytest.fixture(scope="module")
def without_classes(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of the drive that keeps everything and says of nothing what it is."""
    out = tmp_path_factory.mktemp("unclassified")
    config = RunConfig(source="simulated", keep_movable=True, effort="fast", gop=5)
    graph = GraphOptions(last="residual_code")
    run_sequences(RunRequest(config, [SEQUENCE], out, root, 0, graph=graph, quiet=True))
    return out / "archives" / f"{SEQUENCE}.mcap"


def test_a_map_of_an_archive_without_classes_says_so(
    request_: Callable[..., MapRequest], without_classes: Path, root: Path, tmp_path: Path
) -> None:
    """Nothing that was not measured stands in its table."""
    request = request_(tmp_path / "out", archives=[without_classes], against=root)
    summary = make_map(request)
    assert summary["archives_without_classes"] == [str(without_classes)]
    assert summary["voxels"]["dropped"] == 0
    assert "ours, classes only" not in {row["cleaner"] for row in summary["quality"]}
    kept = make_map(
        replace(request, out=tmp_path / "kept", config=CONFIG.model_copy(update={"keep_movable": True}))
    )
    assert kept["archives_without_classes"] == []


def test_the_network_is_asked_for_an_archive_without_classes(
    request_: Callable[..., MapRequest],
    without_classes: Path,
    archive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once for each scan; an archive that says what is movable is believed."""
    asked = []

    def by_labels(scans: list[Scan], *_: object) -> list[np.ndarray]:
        asked.extend(scan.name for scan in scans)
        told = Archive.open(archive)
        return [told[scan.name].classes for scan in scans]

    monkeypatch.setattr("salpcc.stages.segment.labelling.network_classes", by_labels)
    config = CONFIG.model_copy(update={"labels": "network"})
    summary = make_map(request_(tmp_path / "out", archives=[without_classes], config=config))
    assert sorted(asked) == [f"{k:06d}" for k in range(SCANS)]
    assert summary["archives_without_classes"] == [] and summary["voxels"]["dropped"] > 1000
    told = make_map(request_(tmp_path / "told", config=config))
    assert len(asked) == SCANS
    assert told["voxels"] == summary["voxels"]


@pytest.mark.usefixtures("open3d")
def test_localisation_without_classes_measures_with_movables_only(
    without_classes: Path, root: Path, tmp_path: Path
) -> None:
    request = LocaliseRequest([without_classes], root, tmp_path, every=8, thin=16, workers=0, quiet=True)
    rows = registration_figures(localise(request))
    assert {(row["cloud"], row["movable"]) for row in rows} == {
        ("source", True), ("source", False), ("sensor", True),
    }  # fmt: skip


def test_commands_say_at_once_that_there_are_no_classes(
    without_classes: Path, root: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "salpcc.pipeline.cli", "map", str(without_classes), "--workers", "0"]
    result = subprocess.run([*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert f"{without_classes}: no classes in it" in result.stderr and "--keep-movable" in result.stderr
    assert "movable classes are not known" in result.stdout


def test_coordinates_of_a_country_are_the_same_map_moved(
    request_: Callable[..., MapRequest], poses: Path, archive: Path, tmp_path: Path
) -> None:
    """In UTM the map has the same voxels, in every format that can say so, to a millimetre."""
    away = np.array([455_000.0, 5_428_000.0, 110.0])
    far = tmp_path / "far" / "poses.txt"
    far.parent.mkdir()
    eye = "1 0 0 0 0 1 0 0 0 0 1 0"
    (far.parent / "calib.txt").write_text(f"P0: {eye}\nTr: {eye}\n")
    local = read_poses(poses)
    moved = local.copy()
    moved[:, :3, 3] += away
    rows = [" ".join(f"{v:.12g}" for v in pose[:3].ravel()) for pose in moved]
    far.write_text("\n".join(rows) + "\n")
    here = make_map(request_(tmp_path / "here", poses=[str(poses)], formats=["laz"]))
    there = make_map(request_(tmp_path / "there", poses=[str(far)], formats=["laz", "ply"], crs="EPSG:25832"))
    assert here["origin"] == [0.0, 0.0, 0.0]
    assert np.abs(np.array(there["origin"]) - away - local[0, :3, 3]).max() < 1e-3
    assert abs(here["voxels"]["kept"] - there["voxels"]["kept"]) <= 1e-3 * here["voxels"]["kept"]

    def laz(out: Path) -> np.ndarray:
        parts = [np.array(laspy.read(path).xyz) for path in sorted((out / "tiles").glob("*.laz"))]
        return np.concatenate(parts)

    def nearest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(cKDTree(b).query(a)[0])

    base, utm = laz(tmp_path / "here"), laz(tmp_path / "there")
    off = nearest(utm - away, base)
    assert np.quantile(off, 0.99) < 0.0015  # LAZ holds millimetres; a few points cross a voxel's border
    header = laspy.open(next((tmp_path / "there" / "tiles").glob("*.laz"))).header
    assert "25832" in str(header.parse_crs().to_epsg())
    ply = [PlyData.read(path) for path in sorted((tmp_path / "there" / "tiles").glob("*.ply"))]
    told = np.array([float(v) for v in ply[0].comments[0].split()[1:4]])
    xyz = np.concatenate([np.column_stack([p["vertex"][axis] for axis in "xyz"]) for p in ply]).astype(
        np.float64
    )
    assert np.quantile(nearest(xyz + told, utm), 0.999) < 0.0015
    placed = np.loadtxt(tmp_path / "there" / "poses.txt").reshape(-1, 3, 4)
    assert np.abs(placed[:, :, 3] - moved[:, :3, 3]).max() < 1e-3


@pytest.fixture(scope="module")
def raw_root(root: Path, archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive as the sensor gave it, not compensated, with poses that are off by 5 cm and 0.2 degrees from scan to scan."""
    out = tmp_path_factory.mktemp("raw") / "sequences" / SEQUENCE
    (out / "velodyne").mkdir(parents=True)
    shutil.copytree(root / "sequences" / SEQUENCE / "labels", out / "labels")
    for scan in Archive.open(archive):
        assert scan.motion is not None
        raw, *_ = untwist(scan.points, scan.motion)
        rows = np.column_stack([raw / 1000.0, scan.intensity]).astype(np.float32)
        rows.tofile(out / "velodyne" / f"{scan.name}.bin")
    eye = "1 0 0 0 0 1 0 0 0 0 1 0"
    (out / "calib.txt").write_text(f"P0: {eye}\nTr: {eye}\n")
    rng = np.random.default_rng(0)
    lines = []
    for pose in read_poses(root / "sequences" / SEQUENCE / "poses.txt"):
        pose[:3, 3] += rng.normal(0, 0.05, 3)
        turn = Rotation.from_rotvec(np.radians(rng.normal(0, 0.2, 3))).as_matrix()
        pose[:3, :3] = pose[:3, :3] @ turn
        lines.append(" ".join(f"{value:.9f}" for value in pose[:3].ravel()))
    (out / "poses.txt").write_text("\n".join(lines) + "\n")
    return out.parents[1]


@pytest.fixture(scope="module")
def raw_archive(raw_root: Path) -> Path:
    config = RunConfig(source="simulated", labels="given", effort="fast", gop=5)
    graph = GraphOptions(last="residual_code")
    out = raw_root / "run"
    run_sequences(RunRequest(config, [SEQUENCE], out, raw_root, workers=0, graph=graph, quiet=True))
    return out / "archives" / f"{SEQUENCE}.mcap"


@pytest.mark.usefixtures("open3d")
def test_raw_scans_are_registered_de_skewed_too(raw_root: Path, raw_archive: Path, tmp_path: Path) -> None:
    """Beside the rows of Table V as they are recorded."""
    request = LocaliseRequest([raw_archive], raw_root, tmp_path, every=9, thin=32, workers=0, quiet=True)
    rows = {
        (row["cloud"], row["movable"], row["method"]): row for row in registration_figures(localise(request))
    }
    kinds = ("source", "sensor", "source, de-skewed", "sensor, de-skewed")
    assert {cloud for cloud, *_ in rows} == set(kinds) and len(rows) == 16
    for movable in (True, False):
        as_recorded, moved = (rows[kind, movable, "point to plane"] for kind in (kinds[0], kinds[2]))
        assert moved["rotation_deg_mean"] != as_recorded["rotation_deg_mean"]
        ours = rows[kinds[3], movable, "point to plane"]
        assert ours["pairs"] == 1 and ours["translation_m_mean"] == moved["translation_m_mean"]


def test_a_raw_drive_with_spoiled_poses_makes_a_clean_map(
    request_: Callable[..., MapRequest], raw_root: Path, raw_archive: Path, poses: Path, tmp_path: Path
) -> None:
    """Scans are de-skewed and poses refined."""
    spoiled = raw_root / "sequences" / SEQUENCE / "poses.txt"
    asked = request_(
        tmp_path / "map",
        archives=[raw_archive],
        poses=[str(spoiled)],
        against=raw_root,
    )
    refined = make_map(asked)
    taken = CONFIG.model_copy(update={"refine_poses": False})
    as_given = make_map(replace(asked, out=tmp_path / "given", config=taken))

    def sa(summary: dict) -> float:
        return next(r["sa"] for r in summary["quality"] if (r["cleaner"], r["truth"]) == ("ours", "moving"))

    assert sa(refined) > 0.995
    assert refined["voxels"]["kept"] < 0.9 * as_given["voxels"]["kept"]  # walls are as thin as they are
    fit = refined["pose_fit"]
    assert fit["refined"] and fit["residual_m"] < 0.5 * fit["given_residual_m"]
    assert not as_given["pose_fit"]["refined"]
    truth = read_poses(poses)
    steps = [np.linalg.inv(truth[k - 1]) @ truth[k] for k in range(1, SCANS)]

    def off(path: Path) -> float:
        rows = np.loadtxt(path).reshape(-1, 3, 4)
        found = np.concatenate([rows, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (SCANS, 1, 1))], axis=1)
        return max(
            float(np.linalg.norm((np.linalg.inv(found[k - 1]) @ found[k])[:3, 3] - steps[k - 1][:3, 3]))
            for k in range(1, SCANS)
        )

    assert off(tmp_path / "map" / "poses.txt") < 0.03 < off(spoiled)


def test_voxels_that_would_have_the_key_of_others_are_refused() -> None:
    xyz = np.array([[0.0, 0.0, 0.0], [0.1 * 2**21, 0.0, 0.0]])
    assert len(keys_of(xyz[:1], 0.1)) == 1
    for axis, far in ((0, 0.1 * 2**21), (1, -0.1 * 2**21 - 0.1), (2, 0.1 * 2**17)):
        points = np.zeros((2, 3))
        points[1, axis] = far
        with pytest.raises(SalpccError, match="choose a larger --voxel"):
            keys_of(points, 0.1)


def test_a_part_of_a_map_is_that_of_the_whole(
    request_: Callable[..., MapRequest], made: Path, root: Path, poses: Path, tmp_path: Path
) -> None:
    """What is made within a box is what the whole map has there, by its class and what other scans saw, to the bit."""
    place = read_poses(poses)[4, :3, 3]
    box = (*(place - [7.3, 11.1, 2.0]), *(place + [9.2, 6.4, 3.0]))
    whole = make_map(request_(made, config=CONFIG.model_copy(update={"fill": True}), against=root,
                              formats=["laz", "ply", "pcd", "mcap"]))  # fmt: skip
    config = CONFIG.model_validate({**CONFIG.model_dump(), "fill": True, "within": box})
    part = make_map(request_(tmp_path, config=config, against=root, explain=True))
    assert 0 < part["voxels"]["kept"] < whole["voxels"]["kept"] / 4
    assert 0 < part["voxels"]["dropped"] < whole["voxels"]["dropped"]

    def rows(out: Path, tiles: list[str]) -> np.ndarray:
        found = [PlyData.read(out / "tiles" / f"{tile}.ply")["vertex"].data for tile in tiles]
        return np.sort(np.concatenate(found), order=["x", "y", "z"])

    everything = rows(made, whole["tiles"])
    xyz = np.column_stack([everything[axis] for axis in "xyz"])
    inside = ((xyz >= box[:3]) & (xyz < box[3:])).all(axis=1)
    np.testing.assert_array_equal(rows(tmp_path, part["tiles"]), everything[inside])
    figures = {(row["cleaner"], row["truth"]): row for row in part["quality"]}
    assert figures["ours", "moving"]["sa"] > 0.98 and figures["none", "moving"]["sa"] > 0.999


def test_a_part_where_nothing_is_is_wrong_use(
    request_: Callable[..., MapRequest], made: Path, tmp_path: Path
) -> None:
    shutil.copytree(made / "shards", tmp_path / "shards")
    config = CONFIG.model_validate({**CONFIG.model_dump(), "within": (500, 0, -5, 600, 50, 5)})
    with pytest.raises(UsageError, match=r"no scan came within 40 m of it; the drive is in -?\d"):
        make_map(request_(tmp_path, config=config))


def test_a_map_is_carved_as_was_tuned(
    request_: Callable[..., MapRequest], made: Path, root: Path, tmp_path: Path
) -> None:
    """What was tried is told, the best is taken, and the map is no worse for it."""
    shutil.copytree(made / "shards", tmp_path / "shards")
    asked = request_(tmp_path, against=root, tune=True, keep_shards=False)
    summary = make_map(asked)
    trials = summary["tuning"]
    assert len(trials) == 18 and trials[0]["aa"] == max(trial["aa"] for trial in trials)
    taken = next(t for t in trials if summary["config"]["carving"].items() <= t.items())
    assert trials[0]["aa"] - taken["aa"] <= 0.001
    ours = next(r for r in summary["quality"] if (r["cleaner"], r["truth"]) == ("ours", "moving"))
    assert ours["sa"] > 0.99 and ours["da"] > 0.98
    assert make_map(asked) == summary


def test_a_movable_layer_is_taken_out_and_kept_where_it_is_read(
    request_: Callable[..., MapRequest], root: Path, tmp_path: Path
) -> None:
    """By default a map reads no byte of it; with all layers it is removed with a reason."""
    config = RunConfig(source="simulated", labels="given", classes=False, effort="fast", gop=5)
    graph = GraphOptions(last="residual_code")
    run_sequences(RunRequest(config, [SEQUENCE], tmp_path / "run", root, workers=0, graph=graph, quiet=True))
    layered = tmp_path / "run" / "archives" / f"{SEQUENCE}.mcap"
    assert Archive.open(layered)[0].movable is not None
    static = make_map(request_(tmp_path / "static", archives=[layered], keep_shards=False))
    assert static["voxels"]["dropped"] == 0
    asked = request_(
        tmp_path / "all", archives=[layered], config=CONFIG.model_copy(update={"layers": "all"}), explain=True,
        formats=["laz"], keep_shards=False,
    )  # fmt: skip
    both = make_map(asked)
    assert both["points_in"] > static["points_in"] and both["voxels"]["dropped"] > 1000
    assert abs(both["voxels"]["kept"] / static["voxels"]["kept"] - 1) < 0.02
    removed = [laspy.read(path) for path in (tmp_path / "all" / "removed").glob("*.laz")]
    by_class = sum(int(np.count_nonzero(np.asarray(las.reason) & 2)) for las in removed)
    assert by_class > 1000
