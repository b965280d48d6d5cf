"""Damaged archives: verification finds any flipped bit, recovery gives back what is whole and names the rest."""

import json
import random
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from salpcc.pipeline import Archive, encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.edit.recover import Recovery, recover
from salpcc.pipeline.verify import verify
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.log import LogAttachment, LogChannel, LogMessage, LogMetadata
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive

NAMES = [f"{n:06d}" for n in range(5)]


@pytest.fixture(scope="module")
def whole(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small archive: 5 scans in GOPs of 2, 2 and 1."""
    scans = (
        SOURCES["semantickitti"].read(ref, False) for ref in SOURCES["semantickitti"].scans(toy_root, "00")
    )
    path = tmp_path_factory.mktemp("whole") / "00.mcap"
    return encode_scans(scans, path, "00", effort="fast", gop=2, keep_movable=True)


@pytest.fixture(scope="module")
def data(whole: Path) -> bytes:
    return whole.read_bytes()


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    return tmp_path / "bad" / "00.mcap"


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Start, opcode and end of every record."""
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((at, opcode, at + 9 + length))
        at += 9 + length
    return found


def starts(data: bytes, opcode: int) -> list[int]:
    return [start for start, found, _ in records(data) if found == opcode]


def flipped(data: bytes, *bits: int) -> bytes:
    out = bytearray(data)
    for bit in bits:
        out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def rescue(bad: Path, content: bytes, **options: object) -> Recovery:
    bad.parent.mkdir(exist_ok=True)
    bad.write_bytes(content)
    return recover(bad, bad.with_name("new.mcap"), **options)  # type: ignore[arg-type]


def same_scans(one: Path, other: Path, names: list[str]) -> None:
    """The scans of ``one`` are those of ``other`` by these names, to the bit."""
    with Archive.open(one) as left, Archive.open(other) as right:
        assert left.names == names
        wanted = {scan.name: scan for scan in right}
        for scan in left:
            source = wanted[scan.name]
            assert scan.points.tobytes() == source.points.tobytes()
            assert scan.intensity.tobytes() == source.intensity.tobytes()
            assert (scan.time, scan.frame_id) == (source.time, source.frame_id)
    assert verify(one).good


def test_every_flipped_bit_is_found(data: bytes, tmp_path: Path) -> None:
    """All bits of the magics and of the framing of records, and others at random over the whole file."""
    rng = random.Random(8)
    frames = [bit for start, _, _ in records(data) for bit in range(8 * start, 8 * start + 72)]
    tail = range(8 * records(data)[-1][0], 8 * len(data))
    for bit in {*range(64), *rng.sample(frames, 400), *tail, *rng.sample(range(8 * len(data)), 400)}:
        (tmp_path / "bad.mcap").write_bytes(flipped(data, bit))
        with pytest.raises(ArchiveError):
            ArchiveReader(tmp_path / "bad.mcap").check()


def test_verify_tells_of_a_flipped_bit_and_of_what_follows_data_end(data: bytes, bad: Path) -> None:
    bad.parent.mkdir()
    end = starts(data, 0x0F)[0]
    for bit in (8 * (end + 1) + 3, 8 * starts(data, 0x06)[1] + 800, 8 * (end - 30)):
        bad.write_bytes(flipped(data, bit))
        try:
            assert not verify(bad).good
        except ArchiveError as error:
            assert "00.mcap" in str(error)


def test_a_whole_archive_comes_back_byte_for_byte(data: bytes, bad: Path) -> None:
    found = rescue(bad, data)
    assert found.complete and found.scans == 5
    assert bad.with_name("new.mcap").read_bytes() == data
    with pytest.raises(UsageError, match="exists"):
        recover(bad, bad.with_name("new.mcap"))


def test_truncation_costs_what_is_cut_off(data: bytes, whole: Path, bad: Path) -> None:
    firsts = starts(data, 0x06)
    index, end = starts(data, 0x09)[-1], starts(data, 0x0F)[0]
    cuts = {
        len(data) - 1: (5, []),
        end - 1: (5, []),
        index + 40: (5, []),
        index - 1: (5, []),
        firsts[2] + 60: (4, ["000004"]),
        firsts[2] - 9: (4, []),  # nothing is left that names the last scan
        firsts[1] + 60: (2, ["000002", "000003"]),
        (firsts[0] + firsts[1]) * 4 // 5: (1, ["000001"]),  # a broken GOP gives its first scan
    }
    for cut, (scans, gone) in cuts.items():
        found = rescue(bad, data[:cut])
        assert (found.scans, found.gone) == (scans, gone), cut
        assert found.complete == (cut > end), cut
        assert any("the index is gone" in note for note in found.notes) == (cut < index), cut
        # Side files and attachments stand between the index and the end: nobody knows whether there were any.
        assert any("the end of the file is gone" in note for note in found.notes) == (cut < end), cut
        same_scans(bad.with_name("new.mcap"), whole, NAMES[:scans])
        bad.with_name("new.mcap").unlink()


def test_nothing_left_is_an_error_and_no_file(data: bytes, bad: Path) -> None:
    for content in (b"", data[:3000], data[: starts(data, 0x06)[0]], bytes(10000)):
        with pytest.raises(ArchiveError, match=r"00\.mcap"):
            rescue(bad, content)
        assert not bad.with_name("new.mcap").exists()


def test_an_empty_file_is_called_so(bad: Path) -> None:
    with pytest.raises(ArchiveError, match=r"00\.mcap: an empty file"):
        rescue(bad, b"")


@pytest.mark.parametrize("index", ["index", "no index"])
def test_any_damage_costs_its_own_scans_only(data: bytes, whole: Path, bad: Path, index: str) -> None:
    """A bit anywhere: what comes back is what went in, and all that does not is named or told of."""
    rng = random.Random(index)
    chunks = [(start, end) for start, opcode, end in records(data) if opcode == 0x06]
    first, last = starts(data, 0x80)[0], starts(data, 0x09)[-1]  # behind the sensor, before the index
    bits = rng.sample(range(8 * first, 8 * last), 12) + [
        8 * start + 8 * k for start, _ in chunks for k in (0, 3)
    ]
    extra = [] if index == "index" else [8 * (last + 60)]
    for bit in bits:
        found = rescue(bad, flipped(data, bit, *extra))
        names = [name for name in NAMES if name not in found.gone]
        assert len(found.gone) <= 2 and found.scans == len(names), bit // 8
        hit = any(start <= bit // 8 < end for start, end in chunks)
        assert hit or not found.gone, bit // 8
        same_scans(bad.with_name("new.mcap"), whole, names)
        bad.with_name("new.mcap").unlink()


def test_bytes_that_are_gone_from_the_middle(data: bytes, whole: Path, bad: Path) -> None:
    """A chunk, the record before it and the index: the gap is told of, and so is the end."""
    second, last = starts(data, 0x80)[1], starts(data, 0x09)[-1]
    hole = range(second, second + 2000)
    content = data[: hole.start] + bytes(len(hole)) + data[hole.stop : last + 50]
    found = rescue(bad, content)
    assert (found.scans, found.gone) == (3, [])
    assert [note for note in found.notes if "GOP 1" in note] and not found.complete
    same_scans(bad.with_name("new.mcap"), whole, ["000000", "000001", "000004"])
    assert [len(gop) for gop in ArchiveReader(bad.with_name("new.mcap")).gops] == [2, 0, 1]


def test_a_sensor_model_that_is_gone_is_replaced_by_its_digest_only(
    data: bytes, whole: Path, bad: Path
) -> None:
    at = 8 * (data.index(b"description") + 40)
    found = rescue(bad, flipped(data, at))
    assert found.scans == 5 and found.notes[0] == "the configuration is gone" and "hdl64e" in found.notes[1]
    same_scans(bad.with_name("new.mcap"), whole, NAMES)
    bad.with_name("new.mcap").unlink()
    facts = 8 * (data.index(b"sensor\x10\0\0\0") + 12)  # its digest
    with pytest.raises(ArchiveError, match="--sensor"):
        rescue(bad, flipped(data, at, facts))
    assert rescue(bad, flipped(data, at, facts), sensor=load_sensor("hdl64e")).scans == 5


def test_other_topics_of_a_log_come_along(whole: Path, bad: Path) -> None:
    """What passes through comes back chunk by chunk, and a damaged chunk of it is told of."""
    reader = ArchiveReader(whole)
    channel = LogChannel(1, "/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", b"text", (("a", "b"),))
    times = [payload.time for gop in range(3) for payload in reader.payloads(gop)]
    messages = [LogMessage(1, time + 5, time, n, b"imu" * 20 + bytes([n])) for n, time in enumerate(times)]
    enclosed = [
        LogAttachment(1, 2, "index", "text/plain", b"[]"),
        LogMetadata("salpcc", (("archive_version", "9"), ("a", "b"))),
        LogMetadata("empty", ()),
    ]
    log = PassingLog([channel], iter(messages), enclosed)
    bad.parent.mkdir()
    write_archive(bad, reader.facts, [reader.payloads(gop) for gop in range(3)], log)
    data = bad.read_bytes()
    assert rescue(bad, data).complete and bad.with_name("new.mcap").read_bytes() == data
    bad.with_name("new.mcap").unlink()
    chunks = [at for at in starts(data, 0x06) if data[at + 37 : at + 45] == b"\4\0\0\0zstd"]
    assert len(chunks) == 4
    found = rescue(bad, flipped(data, 8 * (chunks[1] + 70)))
    assert found.notes == ["1 chunks or attachments of the rest of the log are gone"] and found.scans == 5
    new = ArchiveReader(bad.with_name("new.mcap"))
    assert list(new.enclosed()) == enclosed
    came = list(new.passing())
    assert [message.sequence for message in came] == [0, 3, 4]
    assert all(replace(message, at=()) == messages[message.sequence] for message in came)
    # A chunk that is cut out without a trace is missed in the summary.
    bad.with_name("new.mcap").unlink()
    (at, end), *_ = [(start, end) for start, opcode, end in records(data) if start == chunks[1]]
    found = rescue(bad, data[:at] + data[end:])
    assert found.notes == ["1 chunks or attachments of the rest of the log are gone"] and found.scans == 5
    for name, left in (
        (b"text/plain", enclosed[1:]),
        (b"archive_version\x01\0\0\x009", [enclosed[0], enclosed[2]]),
    ):
        bad.with_name("new.mcap").unlink()
        broken = data[: data.index(name)] + bytes([name[0] ^ 1]) + data[data.index(name) + 1 :]
        assert not rescue(bad, broken[: data.rindex(b"\x0f" + struct.pack("<Q", 4))]).complete
        assert list(ArchiveReader(bad.with_name("new.mcap")).enclosed()) == left


def test_command_line(data: bytes, bad: Path, tmp_path: Path) -> None:
    bad.parent.mkdir()
    bad.write_bytes(data[: starts(data, 0x06)[1] + 60])
    new = tmp_path / "new.mcap"
    done = CliRunner().invoke(app, ["recover", str(bad), "--out", str(new), "--json"])
    found = json.loads(done.stdout)
    assert done.exit_code == 1 and found["gone"] == ["000002", "000003"] and found["scans"] == 2
    done = CliRunner().invoke(app, ["recover", str(new), "--out", str(tmp_path / "again.mcap")])
    assert done.exit_code == 0 and "2 scans recovered, nothing is gone" in done.stdout
