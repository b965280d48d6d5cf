"""The whole sequence in its archive: labels and small files come back byte for byte, are checked, redacted, recovered."""

import filecmp
import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from plyfile import PlyData
from typer.testing import CliRunner

from salpcc.pipeline import Archive, encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.edit.cut import Selection, cut
from salpcc.pipeline.edit.merge import merge
from salpcc.pipeline.edit.recover import recover
from salpcc.pipeline.edit.redact import Selection as Choice
from salpcc.pipeline.edit.redact import redact
from salpcc.pipeline.files.tree import ArchiveTree
from salpcc.pipeline.run import RunResult
from salpcc.schemas.errors import LogWarning, SourceError, UsageError
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.documents import MARK
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import decode_gop, encode_layers
from salpcc.stages.residual_code.label_coder import encode_labels, labelled
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan
from salpcc.stages.segment.stage import without_classes

LAYERED = {"keep_movable": False, "labels": "given", "effort": "fast"}


def command(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.exit_code, result.output


def same(one: Path, other: Path) -> bool:
    """``diff -r`` of two folders finds nothing."""
    found = filecmp.dircmp(one, other, ignore=[])
    names = found.left_only or found.right_only or found.common_funny
    equal = not names and not any(filecmp.cmpfiles(one, other, found.common_files, shallow=False)[1:])
    return equal and all(same(one / name, other / name) for name in found.common_dirs)


@pytest.fixture(scope="module")
def root(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence with all that may lie in its folder."""
    root = tmp_path_factory.mktemp("whole")
    shutil.copytree(toy_root / "sequences" / "00", root / "sequences" / "00")
    folder = root / "sequences" / "00"
    (folder / "calib.txt").write_bytes(b"Tr: 1 0 0 0 0 1 0 0 0 0 1 0\r\n")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 6)
    (folder / "empty.txt").write_bytes(b"")
    (folder / "notes").mkdir()
    (folder / "notes" / "réadme.md").write_text("überall\n")
    return root


@pytest.fixture(scope="module")
def whole(root: Path, tmp_path_factory: pytest.TempPathFactory, run: Callable[..., RunResult]) -> Path:
    out = tmp_path_factory.mktemp("out")
    assert not run(root, out, "00", **LAYERED).failed
    return out / "archives" / "00.mcap"


@pytest.mark.parametrize(
    "options",
    [LAYERED, {"keep_movable": True, "effort": "fast"}, LAYERED | {"max_error": 0.02}, LAYERED | {"drop_movable": True}],
    ids=["layered", "one layer", "lossy", "dropped"],
)  # fmt: skip
def test_the_folder_comes_back(
    root: Path, tmp_path: Path, run: Callable[..., RunResult], options: dict
) -> None:
    assert not run(root, tmp_path, "00", **options).failed
    path = tmp_path / "archives" / "00.mcap"
    code, said = command("decode", path, "--to", "kitti", "--out", tmp_path / "back")
    assert code == 0, said
    back, folder = tmp_path / "back" / "sequences" / "00", root / "sequences" / "00"
    if "drop_movable" not in options:
        assert same(back / "labels", folder / "labels")
    if "drop_movable" not in options and "max_error" not in options:
        assert same(back, folder)
    for name in ("calib.txt", "poses.txt", "times.txt", "empty.txt", "notes/réadme.md"):
        assert (back / name).read_bytes() == (folder / name).read_bytes()
    code, said = command("verify", path, "--against", root)
    assert code == 0 and "labels of 5 scans, 5 side files" in said, said
    with Archive.open(path) as archive:
        for scan in archive:
            assert scan.labels is not None and len(scan.labels) == len(scan)


def test_of_some_frames_their_labels(root: Path, tmp_path: Path, run: Callable[..., RunResult]) -> None:
    assert not run(root, tmp_path, "00", **LAYERED, frames=(1, 3)).failed
    code, said = command(
        "decode", tmp_path / "archives" / "00.mcap", "--to", "kitti", "--out", tmp_path / "back"
    )
    assert code == 0, said
    back = tmp_path / "back" / "sequences" / "00"
    assert sorted(file.name for file in (back / "labels").iterdir()) == ["000001.label", "000002.label"]
    assert (back / "poses.txt").read_bytes() == (root / "sequences/00/poses.txt").read_bytes()


def test_without_side_files(root: Path, tmp_path: Path, run: Callable[..., RunResult]) -> None:
    """The archive says so, holds none of them, and has the version that it has always had."""
    out = tmp_path / "out"
    code, said = command(
        "run", "sequences", "00", "--root", root, "--out", out, "--workers", 0, "--keep-movable", "--no-side-files",
        "--effort", "fast", "--gop", 2,
    )  # fmt: skip
    assert code == 0 and "beside the points" not in said, said
    reader = ArchiveReader(out / "archives" / "00.mcap")
    assert not reader.side and not reader.has_labels
    assert reader.facts.config["side_files"] is False
    with pytest.raises(UsageError, match="another --side-files"):
        run(root, out, "00", effort="fast")


def test_payloads_are_the_same_with_and_without(
    whole: Path, root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    assert not run(root, tmp_path, "00", **LAYERED, side_files=False).failed
    one, two = ArchiveReader(whole), ArchiveReader(tmp_path / "archives" / "00.mcap")
    for gop in range(3):
        for left, right in (
            (one.payloads(gop), two.payloads(gop)),
            (one.movable_payloads(gop), two.movable_payloads(gop)),
        ):
            assert [p.data for p in left] == [p.data for p in right]
            assert all(p.labels for p in left) and not any(p.labels for p in right)


def test_figures_are_of_the_points(whole: Path) -> None:
    """Labels and side files are told beside them, and in no rate."""
    report = json.loads((whole.parents[1] / "report" / "report.json").read_text())["sequences"]["00"]
    reader = ArchiveReader(whole)
    assert report["labels"] == {"scans": 5, "bytes": reader.labels_bytes}
    assert report["side_files"] == {"files": 5, "bytes": sum(reader.side.values())}
    beside = reader.labels_bytes + sum(reader.side.values())
    assert report["bytes"]["total"] + beside == reader.size
    found = json.loads(command("inspect", whole, "--json")[1])
    assert found["side_files"]["poses.txt"] == reader.side["poses.txt"]
    assert found["bytes_labels"] == reader.labels_bytes > 0
    assert "poses.txt" in command("inspect", whole)[1]


def test_a_run_again_reads_nothing_and_one_of_other_files_is_refused(
    root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    mine = tmp_path / "root"
    shutil.copytree(root, mine)
    folder = mine / "sequences" / "00"
    for file in [*folder.rglob("*.*")]:
        if file.is_file():
            os.utime(file, (1e9, 1e9))
    out = tmp_path / "out"
    run(mine, out, "00", **LAYERED)
    before = (out / "archives" / "00.mcap").read_bytes()
    assert not run(mine, out, "00", **LAYERED).failed
    assert (out / "archives" / "00.mcap").read_bytes() == before
    for name in ("poses.txt", "labels/000003.label"):
        held = (folder / name).read_bytes()
        (folder / name).write_bytes(b"\x0a" + held[1:] if name.endswith("label") else held + b"\n")
        with pytest.raises(UsageError, match="other content"):
            run(mine, out, "00", **LAYERED)
        (folder / name).write_bytes(held)
    (folder / "new.txt").write_text("one more")
    with pytest.raises(UsageError, match="other content"):
        run(mine, out, "00", **LAYERED)


@pytest.mark.parametrize("classes", [False, True], ids=["no classes", "classes"])
def test_labels_that_fit_no_points_are_kept_as_they_are(
    root: Path, tmp_path: Path, run: Callable[..., RunResult], classes: bool
) -> None:
    mine = tmp_path / "root"
    shutil.copytree(root, mine)
    folder = mine / "sequences" / "00"
    (folder / "labels" / "000001.label").write_bytes(b"\x01\x02\x03")
    options = {"keep_movable": not classes, "classes": classes, "effort": "fast"}
    assert not run(mine, tmp_path / "out", "00", **options).failed
    path = tmp_path / "out" / "archives" / "00.mcap"
    code, said = command("decode", path, "--to", "kitti", "--out", tmp_path / "back")
    assert code == 0 and same(tmp_path / "back" / "sequences" / "00", folder), said
    code, said = command("verify", path, "--against", mine)
    assert code == 0 and "labels of 4 scans, 6 side files" in said, said


def test_what_is_no_small_text_stays_behind_and_is_told(
    root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    mine = tmp_path / "root"
    shutil.copytree(root, mine)
    folder = mine / "sequences" / "00"
    (folder / "image_2").mkdir()
    for name in ("image_2/1.png", "image_2/2.png", "table.bin", "labels/000099.label", ".hidden.txt"):
        (folder / name).write_bytes(b"\0\1")
    (folder / "odd.txt").write_bytes(b"a\0b")
    with pytest.warns(LogWarning) as said:
        run(mine, tmp_path / "out", "00", **LAYERED)
    told = " ".join(str(warning.message) for warning in said)
    assert "image_2 (2 files), labels/000099.label, table.bin" in told and "odd.txt: no text" in told
    assert "hidden" not in told
    assert sorted(ArchiveReader(tmp_path / "out/archives/00.mcap").side) == sorted(
        ["calib.txt", "empty.txt", "notes/réadme.md", "poses.txt", "times.txt"]
    )


def test_verify_finds_other_content(whole: Path, root: Path, tmp_path: Path) -> None:
    mine = tmp_path / "root"
    shutil.copytree(root, mine)
    folder = mine / "sequences" / "00"
    labels = np.fromfile(folder / "labels" / "000002.label", np.uint32)
    labels[7] ^= 1 << 16
    labels.tofile(folder / "labels" / "000002.label")
    (folder / "times.txt").unlink()
    (folder / "calib.txt").write_text("other")
    code, said = command("verify", whole, "--against", mine)
    assert code == 1
    for problem in ("scan 000002: its labels", "side file times.txt: not in", "side file calib.txt: differs"):
        assert problem in said


def test_redaction_leaves_no_label_of_what_went(whole: Path, root: Path, tmp_path: Path) -> None:
    out = tmp_path / "public.mcap"
    redact(whole, out)
    reader = ArchiveReader(out)
    assert (
        reader.movable == "dropped"
        and reader.has_labels
        and reader.side.keys() == ArchiveReader(whole).side.keys()
    )
    code, said = command("verify", out, "--redacted-from", tmp_path / "public.json")
    assert code == 0, said
    car, moving = np.array([10 | 7 << 16, 252 | 7 << 16], "<u4")
    with Archive.open(out) as archive, Archive.open(whole, layers="static") as static:
        for left, right in zip(archive, static, strict=True):
            assert (left.labels == right.labels).all() and not np.isin(left.labels, [car, moving]).any()
    for label in (car, moving):
        assert label.tobytes() in whole.read_bytes() and label.tobytes() not in out.read_bytes()
    code, said = command(
        "redact", whole, "--out", tmp_path / "some.mcap", "--frames", "2:4", "--classes", "car"
    )
    assert code == 0, said
    with Archive.open(tmp_path / "some.mcap") as some, Archive.open(whole) as all_:
        for at, (left, right) in enumerate(zip(some, all_, strict=True)):
            gone = np.isin(right.labels & 0xFFFF, [10, 252]) if at in (2, 3) else np.zeros(len(right), bool)
            assert (left.labels == right.labels[~gone]).all()


def test_recovery(whole: Path, root: Path, tmp_path: Path) -> None:
    """What is whole comes back, labels and side files, too; the names of what is gone are told."""
    data = whole.read_bytes()
    again = recover(whole, tmp_path / "again.mcap")
    assert again.complete and (tmp_path / "again.mcap").read_bytes() == data
    reader = ArchiveReader(whole)
    bad = tmp_path / "bad.mcap"
    labels = reader.payloads(0)[0].labels
    bad.write_bytes(data.replace(labels, labels[:-9] + bytes(9)))
    found = recover(bad, tmp_path / "labels.mcap")
    assert found.scans == 5 and found.notes == ["labels gone of scan 000000"]
    with Archive.open(tmp_path / "labels.mcap") as archive:
        assert [scan.labels is None for scan in archive] == [True, False, False, False, False]
    at = data.find(b"side:poses.txt") + 50
    bad.write_bytes(data[:at] + bytes([data[at] ^ 8]) + data[at + 1 :])
    found = recover(bad, tmp_path / "side.mcap")
    assert found.scans == 5 and found.notes == ["1 side files are gone"]
    assert sorted(ArchiveReader(tmp_path / "side.mcap").side) == sorted(reader.side.keys() - {"poses.txt"})
    named = data.find(b"side:poses.txt")
    bad.write_bytes(data[: named - 29] + data[data.find(b"side:", at) - 29 :])  # all of its record
    found = recover(bad, tmp_path / "out.mcap")
    assert found.scans == 5 and found.notes == ["1 side files are gone"]
    bad.write_bytes(data[: at + 10])  # cut off in one side file: others may have been behind it
    found = recover(bad, tmp_path / "less.mcap")
    assert (
        found.scans == 5
        and found.notes[0] == "1 side files are gone"
        and "the end of the file" in found.notes[1]
    )
    code, said = command("verify", tmp_path / "less.mcap", "--against", root)
    assert code == 0 and "5 scans bit-exact" in said, said
    third = [found.start() for found in re.finditer(re.escape(MARK), data)][
        3
    ]  # behind the description and two GOPs
    bad.write_bytes(data[:third])
    found = recover(bad, tmp_path / "cut.mcap")
    with Archive.open(tmp_path / "cut.mcap") as archive, Archive.open(whole) as before:
        assert all((left.labels == right.labels).all() for left, right in zip(archive, before, strict=False))
        assert len(archive) >= 2


def test_redaction_by_a_box_in_the_map(whole: Path, root: Path, tmp_path: Path) -> None:
    """Of what may move goes what lies in the box, at the poses that the archive holds; other chunks stay as they were."""
    with Archive.open(whole) as archive:
        scans = list(archive)
    low, high = np.array([-2.0, -30.0, -5.0]), np.array([40.0, 1.0, 5.0])
    box = ",".join(f"{v:g}" for v in (*low, *high))
    code, said = command("redact", whole, "--out", tmp_path / "box.mcap", "--box", box)
    assert code == 0 and "3 coded anew" in said, said
    far = ",".join(f"{v:g}" for v in (*(low + 1000), *(high + 1000)))
    code, said = command("redact", whole, "--out", tmp_path / "far.mcap", "--box", far)
    assert code == 0 and "3 as they were, 0 coded anew" in said, said
    # Frame 4 alone is a kilometre ahead (the camera's z is the sensor's x): only its chunk is concerned.
    poses = [np.eye(3, 4) for _ in range(6)]
    poses[4] = np.hstack([np.eye(3), [[1000.0], [0.0], [0.0]]])
    (tmp_path / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    (tmp_path / "poses.txt").write_text("".join(" ".join(map(str, p.ravel())) + "\n" for p in poses))
    ahead = ",".join(f"{v:g}" for v in (*(low + [1000, 0, 0]), *(high + [1000, 0, 0])))
    code, said = command("redact", whole, "--out", tmp_path / "one.mcap", "--box", ahead, "--poses", tmp_path / "poses.txt")  # fmt: skip
    assert code == 0 and "2 as they were, 1 coded anew" in said, said
    for name, moved in (("box", range(5)), ("one", [4])):
        assert (
            command("verify", tmp_path / f"{name}.mcap", "--redacted-from", tmp_path / f"{name}.json")[0] == 0
        )
        with Archive.open(tmp_path / f"{name}.mcap") as left:
            for at, (one, other) in enumerate(zip(left, scans, strict=True)):
                inside = ((other.points >= low) & (other.points <= high)).all(axis=1) & (at in moved)
                gone = inside & other.movable
                assert gone.any() == (at in moved) and (other.movable & ~gone).any()
                assert one.points.tobytes() == other.points[~gone].tobytes()
                assert (one.labels == other.labels[~gone]).all() and (
                    one.movable == other.movable[~gone]
                ).all()
    for wrong, told in (("1,2,3", "six numbers"), ("1,1,1,0,2,2", "lower ones"), ("a,b", "six numbers")):
        result = CliRunner().invoke(
            app, ["redact", str(whole), "--out", str(tmp_path / "x.mcap"), "--box", wrong]
        )
        assert isinstance(result.exception, UsageError) and told in str(result.exception)
    bare = ArchiveReader(whole)
    pairs = [[replace(p, movable=m) for p, m in zip(bare.payloads(g), bare.movable_payloads(g), strict=True)] for g in range(3)]  # fmt: skip
    write_archive(tmp_path / "bare.mcap", bare.facts, pairs)
    with pytest.raises(UsageError, match="--poses"):
        redact(tmp_path / "bare.mcap", tmp_path / "x.mcap", Choice(box=(0, 0, 0, 1, 1, 1)))
    write_archive(tmp_path / "short.mcap", bare.facts, pairs, side=[
        SideFile("calib.txt", b"Tr: 1 0 0 0 0 1 0 0 0 0 1 0"), SideFile("poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0")])  # fmt: skip
    with pytest.raises(
        SourceError, match=r"side file poses\.txt: 1 poses, none for scan 000001; .* with --poses FILE$"
    ):
        redact(tmp_path / "short.mcap", tmp_path / "x.mcap", Choice(box=(0, 0, 0, 1, 1, 1)))
    with pytest.raises(SourceError, match=r"^odometry: no poses there; .* with --poses FILE$"):
        redact(whole, tmp_path / "x.mcap", Choice(box=(0, 0, 0, 1, 1, 1)), Path("odometry"))


def test_redaction_by_the_classes_of_labels(whole: Path, tmp_path: Path, root: Path) -> None:
    """Where no classes are stored, labels tell them."""
    source = SOURCES["semantickitti"]
    scans = [
        replace(source.read(ref, True), labels=np.fromfile(ref.labels or "", np.uint32))
        for ref in source.scans(root, "00")[:2]
    ]
    path = encode_scans(scans, tmp_path / "a.mcap", labels="given", keep_movable=False, effort="fast")
    reader = ArchiveReader(path)
    sensor, bare = reader.facts.sensor, [[]]
    statics = list(decode_gop((p.data for p in reader.payloads(0)), sensor))
    state = GopState(sensor)
    moving = [
        decode_scan(p.data, sensor, state, s)
        for p, s in zip(reader.movable_payloads(0), statics, strict=True)
    ]
    coded = encode_layers([(without_classes(s), without_classes(m)) for s, m in zip(statics, moving, strict=True)], sensor, "fast")  # fmt: skip
    for old, layer, (new, other) in zip(reader.payloads(0), reader.movable_payloads(0), coded, strict=True):
        movable = replace(layer, data=other.data, entry=layer.entry.of_sizes(other.sizes))
        bare[0].append(replace(old, data=new.data, entry=old.entry.of_sizes(new.sizes), movable=movable))
    for payload, *sweeps in zip(bare[0], statics, moving, strict=True):
        found = []
        for one, sweep in zip((payload, payload.movable), sweeps, strict=True):
            labels = encode_labels(without_classes(labelled(sweep, one.labels, sensor)), sensor)
            found.append(replace(one, labels=labels, entry=replace(one.entry, labels=len(labels))))
        bare[0][bare[0].index(payload)] = replace(found[0], movable=found[1])
    write_archive(tmp_path / "b.mcap", reader.facts, bare)
    redact(tmp_path / "b.mcap", tmp_path / "c.mcap", Choice(classes=("car",)))
    with Archive.open(tmp_path / "c.mcap") as archive:
        for back, scan in zip(archive, scans, strict=True):
            assert back.classes is None
            assert (back.labels == scan.labels[~np.isin(scan.labels & 0xFFFF, [10, 252])]).all()


def test_parts_have_their_labels_and_all_side_files(whole: Path, tmp_path: Path) -> None:
    """Also those that are coded anew, and parts put together; other content under one name is refused."""
    counts = [cut(whole, tmp_path / f"{a}.mcap", Selection(frames=(a, b))) for a, b in ((0, 3), (3, 5))]
    assert [count.anew for count in counts] == [0, 1]
    merge([tmp_path / "0.mcap", tmp_path / "3.mcap"], tmp_path / "00.mcap")
    before = ArchiveReader(whole)
    with Archive.open(whole) as left, Archive.open(tmp_path / "00.mcap") as right:
        assert [scan.name for scan in right] == [scan.name for scan in left]
        assert all((one.labels == two.labels).all() for one, two in zip(left, right, strict=True))
        assert {name: right.side_file(name) for name in right.side} == {
            n: left.side_file(n) for n in left.side
        }
    part = ArchiveReader(tmp_path / "3.mcap")
    pairs = zip(part.payloads(1), part.movable_payloads(1), strict=True)
    gops, other = [[replace(one, movable=two) for one, two in pairs]], [SideFile("poses.txt", b"other")]
    write_archive(tmp_path / "x.mcap", part.facts, gops, side=other)
    with pytest.raises(UsageError, match=r"another poses\.txt"):
        merge([tmp_path / "0.mcap", tmp_path / "x.mcap"], tmp_path / "y.mcap")
    facts = replace(part.facts, sequence="07")
    write_archive(tmp_path / "07.mcap", facts, gops, side=other)
    merge([tmp_path / "0.mcap", tmp_path / "07.mcap"], tmp_path / "two.mcap")
    both = ArchiveReader(tmp_path / "two.mcap")
    assert both.side.keys() == {f"00/{name}" for name in before.side} | {"07/poses.txt"}


def test_the_archive_as_a_folder_is_the_folder(whole: Path, root: Path) -> None:
    folder = root / "sequences" / "00"
    tree = ArchiveTree(whole)
    there = {f"sequences/00/{p.relative_to(folder).as_posix()}": p for p in folder.rglob("*") if p.is_file()}
    assert tree.files.keys() == there.keys()
    for name, path in there.items():
        assert tree.files[name].read() == path.read_bytes()
        assert tree.files[name].size == path.stat().st_size


def test_ply_and_laz_have_the_labels(whole: Path, root: Path, tmp_path: Path) -> None:
    labels = np.fromfile(root / "sequences/00/labels/000001.label", np.uint32)
    for kind in ("ply", "laz"):
        code, said = command("decode", whole, "--to", kind, "--frames", "1:2", "--out", tmp_path)
        assert code == 0, said
    assert (PlyData.read(tmp_path / "00" / "000001.ply")["vertex"]["label"] == labels).all()
    assert (laspy.read(tmp_path / "00" / "000001.laz")["label"] == labels).all()


def test_raw_drives_keep_their_time_stamps_and_oxts(
    toy_root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    drive = tmp_path / "root" / "2011_09_26" / "2011_09_26_drive_0001_sync"
    data = drive / "velodyne_points" / "data"
    data.mkdir(parents=True)
    for number in range(2):
        shutil.copy(toy_root / "sequences/00/velodyne" / f"{number:06d}.bin", data / f"{number:010d}.bin")
    (drive / "oxts" / "data").mkdir(parents=True)
    stamps = "".join(f"2011-09-26 13:02:25.{n}51199337\n" for n in range(2))
    (drive / "velodyne_points" / "timestamps.txt").write_text(stamps)
    for number in range(2):
        (drive / "oxts" / "data" / f"{number:010d}.txt").write_text(f"49.01{number} 8.43 112.8\n")
    (drive / "oxts" / "dataformat.txt").write_text("lat: latitude\n")
    name = drive.name
    assert not run(
        tmp_path / "root", tmp_path / "out", name, source="kitti_raw", keep_movable=True, effort="fast"
    ).failed
    path = tmp_path / "out" / "archives" / f"{name}.mcap"
    code, said = command("decode", path, "--to", "kitti", "--out", tmp_path / "back")
    assert code == 0, said
    back = tmp_path / "back" / "sequences" / name
    assert same(back / "oxts", drive / "oxts") and not (back / "times.txt").exists()
    assert (back / "velodyne_points" / "timestamps.txt").read_text() == stamps
    code, said = command("verify", path, "--against", tmp_path / "root")
    assert code == 0, said
