"""The archive: what is written is read, MCAP's own tools agree, and no flipped bit passes."""

import io
import random
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.fragments import attachments, gop_records
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import ArchiveWriter, write_archive

FACTS = ArchiveFacts("04", "semantickitti", "d1", {"gop": 2, "max_error": None}, load_sensor("hdl64e"))


def payload(number: int, data: bytes) -> ScanPayload:
    entry = ScanEntry(f"{number:06d}", 30, 20, 10, 1, len(data) - 3, 1, 1, 1)
    return ScanPayload(entry, number * 10**8, "velodyne", data)


GOPS = [
    [payload(0, b"zero" * 50), payload(1, b"one!" * 40)],
    [],  # all its scans failed
    [payload(7, b"seven" * 30)],
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "04.mcap"
    write_archive(path, FACTS, GOPS)
    return path


def test_archive_comes_back(path: Path) -> None:
    reader = ArchiveReader(path)
    assert [reader.payloads(gop) for gop in range(3)] == GOPS
    assert [[e.name for e in gop] for gop in reader.gops] == [["000000", "000001"], [], ["000007"]]
    facts = reader.facts
    assert (facts.sequence, facts.source, facts.inputs, facts.config) == (
        FACTS.sequence, FACTS.source, FACTS.inputs, FACTS.config,
    )  # fmt: skip
    assert facts.sensor.digest == FACTS.sensor.digest
    reader.check()


def test_bytes_are_the_same_every_time(path: Path, tmp_path: Path) -> None:
    write_archive(tmp_path / "again.mcap", FACTS, iter(GOPS))
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()


def test_container_is_what_is_not_payload(path: Path) -> None:
    data = sum(len(p.data) for gop in GOPS for p in gop)
    assert ArchiveReader(path).container_bytes == path.stat().st_size - data


def test_mcap_tools_read_it(path: Path) -> None:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert len(summary.chunk_indexes) == 2  # one per GOP that holds scans
        assert summary.statistics.message_count == 3
        found = [
            (
                schema.name,
                message.log_time,
                message.sequence,
                cloud.width,
                bytes(cloud.compressed_data),
                cloud.format,
            )
            for schema, _, message, cloud in reader.iter_decoded_messages()
        ]
        names = {attachment.name for attachment in reader.iter_attachments()}
    assert found == [
        (
            "point_cloud_interfaces/msg/CompressedPointCloud2",
            p.time,
            int(p.entry.name),
            20,
            p.data,
            "salpcc/3.0",
        )
        for gop in GOPS
        for p in gop
    ]
    assert names == {"description", "index"}


def test_mcap_tools_seek_in_it(path: Path) -> None:
    with path.open("rb") as stream:
        times = [m.log_time for _, _, m in make_reader(stream).iter_messages(starting_at=5 * 10**8)]
    assert times == [7 * 10**8]


def test_rosbags_reads_it(path: Path) -> None:
    with AnyReader([path]) as reader:
        widths = [reader.deserialize(raw, c.msgtype).width for c, _, raw in reader.messages()]
    assert widths == [20, 20, 20]


def read_all(path: Path) -> object:
    reader = ArchiveReader(path)
    reader.check()
    return reader.facts.config, [reader.payloads(gop) for gop in range(len(reader.gops))]


def test_every_flipped_bit_is_found(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    rng = random.Random(1)
    bad = tmp_path / "bad.mcap"
    for _ in range(300):
        at, bit = rng.randrange(len(data)), rng.randrange(8)
        bad.write_bytes(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])
        with pytest.raises(ArchiveError):
            read_all(bad)


def test_every_truncation_is_found(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    bad = tmp_path / "bad.mcap"
    for length in [*range(40), *range(40, len(data), 97), len(data) - 1]:
        bad.write_bytes(data[:length])
        with pytest.raises(ArchiveError, match=r"bad\.mcap"):
            ArchiveReader(bad)


def test_damage_in_one_gop_leaves_the_others(path: Path, tmp_path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[data.index(b"zerozero")] ^= 1
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    reader = ArchiveReader(bad)
    with pytest.raises(ArchiveError, match=r"GOP 0 \(scans 000000 to 000001\)"):
        reader.payloads(0)
    assert reader.payloads(2) == GOPS[2]


@pytest.mark.parametrize(("version", "is_"), [("4.0", "newer"), ("2.0", "older")])
def test_another_major_version_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str, is_: str
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("salpcc.stages.residual_code.archive.format.ARCHIVE_VERSION", version)
        write_archive(tmp_path / "x.mcap", FACTS, GOPS)
    with pytest.raises(ArchiveError, match=is_):
        ArchiveReader(tmp_path / "x.mcap")


@pytest.mark.parametrize("name", ["../../etc/passwd", "a/b", "..", "", "a\\b", "a\0b"])
def test_names_that_lead_astray_are_refused(tmp_path: Path, name: str) -> None:
    entry = ScanEntry(name, 1, 1, 0, 0, 1, 0, 0, 0)
    write_archive(tmp_path / "x.mcap", FACTS, [[ScanPayload(entry, 0, "v", b"x")]])
    with pytest.raises(ArchiveError, match="cannot name a file"):
        ArchiveReader(tmp_path / "x.mcap")


def test_truncated_stream_still_describes_itself() -> None:
    stream = io.BytesIO()
    writer = ArchiveWriter(stream, FACTS)
    writer.add_gop(GOPS[0])  # and the machine dies
    data = stream.getvalue()
    gops = [content for _, _, content in gop_records(data)]  # type: ignore[arg-type]
    assert gops == [{"gop": 0, "scans": ["000000", "000001"], "sequence": "04"}]
    (said,) = attachments(data, "description")  # type: ignore[arg-type]
    assert said["config"] == FACTS.config and said["sensor"]["name"] == "hdl64e"


def test_channels_of_clouds_have_records_where_one_passes_through(tmp_path: Path) -> None:
    cloud = LogChannel(
        3, "/points", "cdr", "sensor_msgs/msg/PointCloud2", "ros2msg", b"\xff text", (("a", "b"),)
    )
    imu = LogChannel(2, "/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", b"text")
    for messages, there in (([], {1, 3}), ([LogMessage(3, 5, 5, 0, b"raw", ())], {1, 3, 4})):
        path = tmp_path / f"{len(there)}.mcap"
        write_archive(path, FACTS, GOPS, PassingLog([cloud, imu], iter(messages)))
        with path.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            assert summary is not None and set(summary.channels) == there
        reader = ArchiveReader(path)
        assert list(reader.log.items()) == [(2, imu), (3, cloud)]
        assert [message.data for message in reader.passing()] == [m.data for m in messages]


def test_empty_archive_is_an_archive(tmp_path: Path) -> None:
    write_archive(tmp_path / "none.mcap", FACTS, [])
    assert ArchiveReader(tmp_path / "none.mcap").gops == []
