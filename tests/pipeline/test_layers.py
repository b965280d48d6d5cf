"""Layered archives: read by layer, recovered, redacted with proof, measured and said in words."""

import json
import pickle
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from salpcc.pipeline import Archive, encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.edit.recover import recover
from salpcc.pipeline.edit.redact import Selection, redact
from salpcc.pipeline.verify import verify
from salpcc.schemas import files
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import message_to_scan, scan_to_message
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive import record_file
from salpcc.stages.residual_code.archive.reader import ArchiveReader

OPTIONS = {"effort": "fast", "gop": 2, "labels": "given", "keep_movable": False}


@pytest.fixture(scope="module")
def scans(toy_root: Path) -> list[Scan]:
    source = SOURCES["semantickitti"]
    return [source.read(ref, True) for ref in source.scans(toy_root, "00")]


@pytest.fixture(scope="module")
def layered(scans: list[Scan], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """5 scans in GOPs of 2, 2 and 1, in two layers."""
    return encode_scans(scans, tmp_path_factory.mktemp("layered") / "00.mcap", "00", **OPTIONS)


def is_movable(scan: Scan) -> np.ndarray:
    return np.asarray(GROUP_OF_CLASS[scan.classes] == MOVABLE)


def command(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.exit_code, result.output


def test_every_layer_comes_back(layered: Path, scans: list[Scan]) -> None:
    with (
        Archive.open(layered) as both,
        Archive.open(layered, layers="static") as static,
        Archive.open(layered, threads=2, layers="movable") as movable,
    ):
        assert both.movable == "layered"
        for one, two, three, scan in zip(
            both, static, pickle.loads(pickle.dumps(movable)), scans, strict=True
        ):
            moves = is_movable(scan)
            assert moves.any() and (one.movable == moves).all() and (one.classes == scan.classes).all()
            for part, which in ((one, slice(None)), (two, ~moves), (three, moves)):
                assert (part.name, part.time) == (scan.name, scan.time)
                assert part.points.tobytes() == scan.points[which].tobytes()
                assert part.intensity.tobytes() == scan.intensity[which].tobytes()
        assert both[4].points.tobytes() == scans[4].points.tobytes()
        assert static[1].points.tobytes() == scans[1].points[~is_movable(scans[1])].tobytes()


def test_the_static_layer_touches_no_byte_of_the_other(
    layered: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    touched: list[tuple[int, int]] = []

    def counting(path: Path, at: int, length: int) -> bytes:
        touched.append((at, at + length))
        return files.read_at(path, at, length)

    monkeypatch.setattr(record_file, "read_at", counting)
    chunks = [
        (chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length)
        for layer, _, chunk in ArchiveReader(layered).layer_chunks()
        if layer == "movable"
    ]
    assert len(chunks) == 3

    def reached(layers: str) -> list[int]:
        touched.clear()
        with Archive.open(layered, layers=layers) as archive:  # type: ignore[arg-type]
            assert len(list(archive)) == 5
        return [sum(max(0, min(end, b) - max(start, a)) for a, b in touched) for start, end in chunks]

    assert reached("static") == [0, 0, 0]
    assert all(reached("all")) and all(reached("movable"))


def test_the_static_layer_is_what_dropping_leaves(layered: Path, scans: list[Scan], tmp_path: Path) -> None:
    dropped = encode_scans(scans, tmp_path / "dropped.mcap", "00", **OPTIONS, drop_movable=True)
    one, two = ArchiveReader(layered), ArchiveReader(dropped)
    assert (one.movable, two.movable) == ("layered", "dropped")
    for gop in range(3):
        assert [p.data for p in one.payloads(gop)] == [p.data for p in two.payloads(gop)]
        assert [p.entry for p in one.payloads(gop)] == [p.entry for p in two.payloads(gop)]
    kept = ArchiveReader(encode_scans(scans, tmp_path / "kept.mcap", "00", effort="fast", gop=2))
    assert kept.movable == "one layer"
    assert not kept.facts.config.keys() & {"layers", "drop_movable", "movable_max_error", "classes"}
    with pytest.raises(UsageError, match="was dropped"):
        Archive.open(dropped, layers="movable")
    for layers in ("static", "movable"):
        with pytest.raises(UsageError, match="one layer"):
            Archive.open(kept.path, layers=layers)
    with pytest.raises(UsageError, match="choose from"):
        Archive.open(layered, layers="moving")  # type: ignore[arg-type]


@pytest.mark.parametrize("bounds", [(0.01, 0.0), (None, 0.05), (0.05, 0.01)])
def test_each_layer_has_its_error(
    scans: list[Scan], tmp_path: Path, toy_root: Path, bounds: tuple[float | None, float]
) -> None:
    options = OPTIONS | {"max_error": bounds[0], "movable_max_error": bounds[1]}
    path = encode_scans(scans[:2], tmp_path / "00.mcap", "00", **options)
    for back, scan in zip(Archive.open(path), scans[:2], strict=True):
        for which, bound in ((~back.movable, bounds[0] or 0.0), (back.movable, bounds[1])):
            off = np.linalg.norm(back.points[which].astype(float) - scan.points[which], axis=1)
            assert off.max() <= bound and (off.max() > 0) == (bound > 0)


def test_a_run_says_what_became_of_what_may_move(tmp_path: Path) -> None:
    """Terminal, report; the network's classes are stored when asked for only, and scored in any case."""
    reports = []
    for more in ([], ["--classes"], ["--drop-movable"]):
        out = tmp_path / "".join(more)
        code, said = command(
            "run", "sequences", "00", "--source", "simulated", "--frames", "0:2", "--effort", "fast",
            "--root", tmp_path / "simulated", "--workers", 0, "--out", out / "out", *more,
        )  # fmt: skip
        assert code == 0, said
        path = out / "out" / "archives" / "00.mcap"
        assert ArchiveReader(path).has_classes == (more == ["--classes"])
        report = json.loads((out / "out" / "report" / "report.json").read_text())["sequences"]["00"]
        assert report["points_lost"] == 0 and report["bit_exact_scans"] == 2
        layers = report["layers"]
        coded = layers["static"]["bytes"] + layers["movable"]["bytes"]
        beside = report["labels"]["bytes"] + report["side_files"]["bytes"]
        assert coded + report["bytes_container"] == report["bytes"]["total"] == path.stat().st_size - beside
        assert ("layered: static" in said) == (report["movable"] == "layered")
        assert ("dropped: what can move" in said) == (report["movable"] == "dropped")
        reports.append(report)
    plain, classes, dropped = reports
    assert [report["movable"] for report in reports] == ["layered", "layered", "dropped"]
    assert plain["points_dropped_movable"] == 0 and plain["points_decoded"] == plain["points_in"]
    assert plain["layers"]["movable"]["points"] == dropped["points_dropped_movable"] > 0
    assert plain["layers"]["static"] == dropped["layers"]["static"]
    assert plain["iou"] == classes["iou"] == dropped["iou"] and plain["iou"]["groups"]["ground"] > 0.3
    assert plain["bytes"]["classes"] == 0 < classes["bytes"]["classes"]


def test_verify_against_the_source(
    layered: Path, toy_root: Path, run: Callable[..., object], tmp_path: Path
) -> None:
    run(toy_root, tmp_path, "00", keep_movable=False, labels="given", effort="fast")
    path = tmp_path / "archives" / "00.mcap"
    code, said = command("verify", path, "--against", toy_root)
    assert code == 0 and "5 scans bit-exact, 0 points dropped" in said
    assert "layered: static" in said
    code, said = command("inspect", path, "--json")
    found = json.loads(said)
    assert found["movable"] == "layered" and found["layers"]["movable"]["points"] > 0
    assert found["totals"]["dropped_movable"] == 0 and found["totals"]["kept"] == found["totals"]["n_points"]


def test_decode_by_layer(layered: Path, scans: list[Scan], tmp_path: Path) -> None:
    for layers, which in (
        ("all", slice(None)),
        ("static", ~is_movable(scans[2])),
        ("movable", is_movable(scans[2])),
    ):
        out = tmp_path / layers
        code, said = command(
            "decode", layered, "--to", "kitti", "--layers", layers, "--frames", "2:3", "--out", out
        )
        assert code == 0, said
        rows = np.fromfile(out / "sequences/00/velodyne/000002.bin", np.float32).reshape(-1, 4)
        assert rows[:, :3].tobytes() == scans[2].points[which].tobytes()


def clouds(seed: int) -> list[Scan]:
    """Scans of recorded messages in rows with loose bytes between them, float64 coordinates, and more fields."""
    found = []
    for n in range(3):
        rng = np.random.default_rng(seed + n)
        height, width, step = 4, 50, 36
        kind = np.dtype({"names": ["x", "y", "z", "intensity", "ring"], "formats": ["<f8"] * 3 + ["<f4", "<u2"],
                         "offsets": [0, 8, 16, 24, 28], "itemsize": step})  # fmt: skip
        rows = np.zeros(height * width, kind)
        for axis in "xyz":
            rows[axis] = rng.normal(0, 20, len(rows))
        rows["intensity"], rows["ring"] = rng.integers(0, 255, len(rows)), np.repeat(np.arange(height), width)
        stride = width * step + 12
        data = rng.integers(0, 255, (height, stride), np.uint8)
        data[:, : width * step] = rows.view(np.uint8).reshape(height, -1)
        fields = tuple(
            (name, kind.fields[name][1], {"<f8": 8, "<f4": 7, "<u2": 4}[kind[name].str], 1)
            for name in kind.names
        )
        cdr = CloudMessage(
            10**9 * n, "lidar", width, data.tobytes(), point_step=step, fields=fields, height=height
        ).to_cdr()
        told = struct.pack("<II", width * step, data.size)
        assert cdr.count(told) == 1
        cdr = cdr.replace(told, struct.pack("<II", stride, data.size))
        scan = message_to_scan(LogMessage(1, 10**9 * n, 10**9 * n, n, cdr), "cdr", "/points", f"{n:06d}")
        classes = rng.choice(np.array([1, 13], np.uint8), len(scan))
        found.append(replace(scan, classes=classes if n != 1 else np.full(len(scan), 13, np.uint8)))
    return found


@pytest.mark.parametrize("max_error", [None, 0.02])
def test_messages_come_back_of_both_layers(tmp_path: Path, max_error: float | None) -> None:
    """No byte of a message is lost; of the static layer alone it is what dropping leaves."""
    recorded = clouds(1)
    path = encode_scans(recorded, tmp_path / "log.mcap", "log", **OPTIONS, max_error=max_error)
    for back, scan in zip(Archive.open(path), recorded, strict=True):
        assert back.cloud is not None and scan.cloud is not None
        assert (back.movable == is_movable(scan)).all()
        assert back.cloud.whole and back.cloud.loose == scan.cloud.loose
        if max_error is None:
            assert scan_to_message(back) == scan_to_message(scan)
    for static, scan in zip(Archive.open(path, layers="static"), recorded, strict=True):
        assert len(static) == (~is_movable(scan)).sum()


def test_a_whole_archive_is_recovered_byte_for_byte(layered: Path, tmp_path: Path) -> None:
    found = recover(layered, tmp_path / "new.mcap")
    assert found.complete and (tmp_path / "new.mcap").read_bytes() == layered.read_bytes()


def layer_ranges(path: Path, layer: str) -> list[tuple[int, int]]:
    return [
        (chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length)
        for which, _, chunk in ArchiveReader(path).layer_chunks()
        if which == layer
    ]


def test_what_is_whole_of_a_damaged_archive_is_recovered(
    layered: Path, scans: list[Scan], tmp_path: Path
) -> None:
    """A broken movable layer costs no static one; a broken static layer costs both of its scans."""
    data = bytearray(layered.read_bytes())
    start, end = layer_ranges(layered, "movable")[1]
    data[(start + end) // 2 + 200] ^= 1  # in its second scan
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    verdict = verify(bad)
    assert not verdict.good and any("movable layer of GOP 1" in problem for problem in verdict.problems)
    found = recover(bad, tmp_path / "new.mcap")
    assert found.scans == 5 and not found.gone and not found.complete
    assert any("movable layer gone of scan 000003" in note for note in found.notes)
    with Archive.open(tmp_path / "new.mcap") as archive:
        for place in (0, 1, 2, 4):
            assert archive[place].points.tobytes() == scans[place].points.tobytes()
        with pytest.raises(ArchiveError, match="scan 000003: its movable layer is gone"):
            archive[3]
    code, said = command("decode", tmp_path / "new.mcap", "--to", "kitti", "--out", tmp_path / "back")
    assert code == 1 and "scan 000003: its movable layer is gone; --layers static" in said
    back = sorted((tmp_path / "back" / "sequences" / "00" / "velodyne").iterdir())
    assert [path.stem for path in back] == ["000000", "000001", "000002", "000004"]
    for frames, left, count in (("0:3", 0, 3), ("3:4", 1, 0)):
        out = tmp_path / frames
        code, said = command("decode", tmp_path / "new.mcap", "--to", "ply", "--frames", frames, "--out", out)
        assert code == left and "failed" not in said and len(list(out.rglob("*.ply"))) == count
    with Archive.open(tmp_path / "new.mcap", layers="static") as archive:
        assert archive[3].points.tobytes() == scans[3].points[~is_movable(scans[3])].tobytes()

    start, end = layer_ranges(layered, "static")[1]
    data = bytearray(layered.read_bytes())
    data[start + 500] ^= 1
    bad.write_bytes(data)
    found = recover(bad, tmp_path / "less.mcap")
    assert found.gone == ["000002", "000003"] and found.scans == 3
    assert [scan.name for scan in Archive.open(tmp_path / "less.mcap")] == ["000000", "000001", "000004"]


def test_a_truncated_archive_is_recovered(layered: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    _, end = layer_ranges(layered, "static")[1]
    bad.write_bytes(layered.read_bytes()[: end + 40])  # the movable layer of GOP 1 is cut off
    found = recover(bad, tmp_path / "new.mcap")
    assert found.scans == 4 and not found.complete
    assert not ArchiveReader(
        tmp_path / "new.mcap"
    ).log  # the channels of its own layers are no topics of a log
    assert len(list(Archive.open(tmp_path / "new.mcap", layers="static"))) == 4
    with Archive.open(tmp_path / "new.mcap") as archive:
        assert len(archive[1]) > 0
        with pytest.raises(ArchiveError, match="movable layer is gone"):
            archive[2]


def test_no_flipped_bit_of_a_movable_chunk_passes(layered: Path, tmp_path: Path) -> None:
    data, rng = layered.read_bytes(), np.random.default_rng(5)
    bad = tmp_path / "bad.mcap"
    for start, end in layer_ranges(layered, "movable"):
        for at in rng.integers(8 * (start + 9), 8 * end, 6):
            broken = bytearray(data)
            broken[at // 8] ^= 1 << at % 8
            bad.write_bytes(broken)
            assert not verify(bad).good
            assert len(list(Archive.open(bad, layers="static"))) == 5


def test_redaction_is_proven(layered: Path, scans: list[Scan], tmp_path: Path) -> None:
    new = tmp_path / "public.mcap"
    code, said = command("redact", layered, "--out", new)
    assert code == 0 and "3 static chunks as they were" in said and "3 gone" in said
    data = new.read_bytes()
    for start, end in layer_ranges(layered, "static"):
        assert layered.read_bytes()[start:end] in data
    for start, end in layer_ranges(layered, "movable"):
        assert layered.read_bytes()[start + 60 : end] not in data
    code, said = command("verify", new, "--redacted-from", tmp_path / "public.json")
    assert code == 0 and "byte for byte" in said and "dropped: what can move" in said
    with Archive.open(new) as archive:
        assert archive.movable == "dropped"
        for back, scan in zip(archive, scans, strict=True):
            assert back.points.tobytes() == scan.points[~is_movable(scan)].tobytes()
    assert ArchiveReader(new).facts.inputs == ""  # no run takes it for its own
    # The archive that still has its movable layer is no redaction, nor is one of other static chunks.
    verdict = verify(layered, redacted_from=tmp_path / "public.json")
    assert not verdict.good and "3 movable chunks are still there" in verdict.problems[0]
    other = encode_scans(scans, tmp_path / "other.mcap", "00", **OPTIONS | {"effort": "default"})
    verdict = verify(other, redacted_from=tmp_path / "public.json")
    assert any("static chunks differ" in problem for problem in verdict.problems)
    for path, match in ((layered, "exists"), (new, "was dropped")):
        target = new if match == "exists" else tmp_path / "again.mcap"
        with pytest.raises(UsageError, match=match):
            redact(path, target)
    with pytest.raises(UsageError, match="no manifest"):
        verify(new, redacted_from=layered)


def test_some_of_it_is_redacted(layered: Path, scans: list[Scan], tmp_path: Path) -> None:
    """Of frames, of classes: chunks that are not concerned stay as they are."""
    before = ArchiveReader(layered)
    of_frame = tmp_path / "frames.mcap"
    redact(layered, of_frame, Selection(frames=(3, 4)))
    assert verify(of_frame, redacted_from=tmp_path / "frames.json").good
    for gop in (0, 2):
        assert ArchiveReader(of_frame).movable_payloads(gop) == before.movable_payloads(gop)
    for back, scan in zip(Archive.open(of_frame), scans, strict=True):
        left = ~is_movable(scan) if scan.name == "000003" else np.ones(len(scan), bool)
        assert back.points.tobytes() == scan.points[left].tobytes()
        assert (back.movable == is_movable(scan)[left]).all()

    mixed = [
        replace(s, classes=np.where(np.arange(len(s)) % 7 == 0, 6, s.classes).astype(np.uint8)) for s in scans
    ]
    source = encode_scans(mixed, tmp_path / "mixed.mcap", "00", **OPTIONS)
    of_class = tmp_path / "people.mcap"
    redact(source, of_class, Selection(classes=("person",)))
    assert verify(of_class, redacted_from=tmp_path / "people.json").good
    for back, scan in zip(Archive.open(of_class), mixed, strict=True):
        left = scan.classes != 6
        assert (
            back.points.tobytes() == scan.points[left].tobytes()
            and (back.classes == scan.classes[left]).all()
        )
    with pytest.raises(UsageError, match="choose from"):
        Selection(classes=("tree",))


def test_proof_of_some_is_of_what_is_left(layered: Path, tmp_path: Path) -> None:
    """Neither what was not redacted, nor what lost more, nor another part passes for it."""
    new, more = tmp_path / "some.mcap", tmp_path / "more.mcap"
    redact(layered, new, Selection(frames=(3, 4)))
    redact(layered, more, Selection(frames=(2, 4)))
    redact(layered, tmp_path / "all.mcap")
    for other in (layered, more, tmp_path / "all.mcap"):
        verdict = verify(other, redacted_from=tmp_path / "some.json")
        assert len(verdict.problems) == 1 and "movable chunks differ" in verdict.problems[0]
    assert verify(new, redacted_from=tmp_path / "some.json").good


def test_redaction_of_nothing_or_over_something_is_refused(layered: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no scan of it is of these frames; it holds 000000 to"):
        redact(layered, tmp_path / "none.mcap", Selection(frames=(70, 80)))
    with pytest.raises(UsageError, match="an archive is a file"):  # its manifest would lie in its place
        redact(layered, tmp_path / "new.json")
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(UsageError, match=r"mine\.json: exists"):
        redact(layered, tmp_path / "mine.mcap")
    assert (tmp_path / "mine.json").read_text() == "{}"
    assert [file.name for file in tmp_path.iterdir()] == ["mine.json"]


def test_part_of_a_message_is_redacted(tmp_path: Path) -> None:
    recorded = clouds(7)
    path = encode_scans(recorded, tmp_path / "log.mcap", "log", **OPTIONS)
    redact(path, tmp_path / "new.mcap", Selection(frames=(0, 1)))
    backs = list(Archive.open(tmp_path / "new.mcap"))
    assert not backs[0].cloud.whole and len(backs[0]) == (~is_movable(recorded[0])).sum()
    assert scan_to_message(backs[2]) == scan_to_message(recorded[2])
