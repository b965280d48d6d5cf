"""Recorded logs in and out: every message of every topic comes back byte for byte."""

import json
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from salpcc.pipeline import Archive
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.mapping.map_plan import plan_map
from salpcc.pipeline.plan.plan import plan_run
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.pipeline.sensors.calibration import calibrate_log
from salpcc.pipeline.verify import verify
from salpcc.schemas import marks
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LogWarning, SourceError, UsageError
from salpcc.stages.ingest.sources import bag as bag_module
from salpcc.stages.ingest.sources.bag import Bag, digest_log, find_log, open_log
from salpcc.stages.ingest.sources.mcap_log import McapLog
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel

CLOUD, TEXT = "sensor_msgs/msg/PointCloud2", "std_msgs/msg/String"
START = 1_600_000_000_000_000_000
# name, byte offset, datatype, count
XYZI = (("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("intensity", 12, 7, 1))
ORGANISED = (("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("ring", 16, 4, 1), ("t", 20, 6, 1))
WIDE = (("x", 0, 8, 1), ("y", 8, 8, 1), ("z", 16, 8, 1), ("intensity", 24, 2, 1), ("stamp", 25, 8, 1))
Recorded = list[tuple[str, int, bytes]]


def lattice_cloud(points: np.ndarray) -> dict[str, object]:
    return {
        "height": 1,
        "width": len(points),
        "fields": XYZI,
        "point_step": 16,
        "rows": points.view(np.uint8),
    }


def organised_cloud(seed: int) -> dict[str, object]:
    """8 lasers by 100 columns of 32 bytes, NaN where nothing came back, garbage between the fields."""
    rng = np.random.default_rng(seed)
    kind = np.dtype({"names": [f[0] for f in ORGANISED], "formats": ["<f4", "<f4", "<f4", "<u2", "<u4"],
                     "offsets": [f[1] for f in ORGANISED], "itemsize": 32})  # fmt: skip
    rows = (
        np.frombuffer(rng.integers(0, 256, (8, 100, 32), dtype=np.uint8).tobytes(), kind)
        .reshape(8, 100)
        .copy()
    )
    for axis in "xyz":
        rows[axis] = np.where(rng.random((8, 100)) < 0.2, np.nan, rng.normal(0, 20, (8, 100)))
    rows["ring"] = np.arange(8)[:, None]
    rows["t"] = np.arange(100) * 97_650
    return {"height": 8, "width": 100, "fields": ORGANISED, "point_step": 32, "rows": rows.view(np.uint8)}


def wide_cloud(seed: int) -> dict[str, object]:
    """300 big-endian points in map coordinates, which no float32 holds."""
    rng = np.random.default_rng(seed)
    kind = np.dtype({"names": [f[0] for f in WIDE], "formats": [">f8", ">f8", ">f8", "u1", ">f8"],
                     "offsets": [f[1] for f in WIDE], "itemsize": 33})  # fmt: skip
    rows = np.zeros(300, kind)
    for axis, origin in zip("xyz", (690_000.0, 5_334_000.0, 500.0), strict=True):
        rows[axis] = origin + rng.normal(0, 30, 300)
    rows["intensity"] = rng.integers(0, 256, 300)
    rows["stamp"] = 1.6e9 + 1e-5 * np.arange(300)
    return {
        "height": 1,
        "width": 300,
        "fields": WIDE,
        "point_step": 33,
        "rows": rows.view(np.uint8),
        "big": True,
    }


def record(ros: int, clouds: dict[str, list[dict[str, object]]]) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, time and bytes of all messages of a drive: clouds at 10 Hz, texts in between."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types, field = store.types, store.types["sensor_msgs/msg/PointField"]
    serialize = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    for number in range(max(map(len, clouds.values()))):
        time = START + number * 100_000_000
        for topic, messages in clouds.items():
            if number < len(messages):
                about = messages[number]
                data = np.ascontiguousarray(about["rows"]).ravel()
                stamp = types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
                seq = {"seq": number} if ros == 1 else {}
                message = types[CLOUD](
                    header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=topic.strip("/"), **seq),
                    height=about["height"],
                    width=about["width"],
                    fields=[field(name=n, offset=o, datatype=d, count=c) for n, o, d, c in about["fields"]],
                    is_bigendian=about.get("big", False),
                    point_step=about["point_step"],
                    row_step=about["point_step"] * about["width"],
                    data=data,
                    is_dense=False,
                )
                yield topic, CLOUD, time + 2_000_000, bytes(serialize(message, CLOUD))
        for place in range(3):
            text = types[TEXT](data=f"text {number} {place}")
            yield "/texts", TEXT, time + place * 30_000_000, bytes(serialize(text, TEXT))


def write_logs(folder: Path, clouds: dict[str, list[dict[str, object]]]) -> dict[str, Recorded]:
    """Write the same drive as a ROS 1 bag, as ROS 2 bags in SQLite and MCAP, and as a bare MCAP; what is in each."""
    stores = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
    recorded: dict[str, Recorded] = {}

    def fill(writer: Rosbag1Writer | Rosbag2Writer, ros: int) -> Recorded:
        rows, connections = [], {}
        for topic, kind, time, data in sorted(record(ros, clouds), key=lambda row: row[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=stores[ros])
            writer.write(connections[topic], time, data)
            rows.append((topic, time, data))
        return sorted(rows)

    bag1 = Rosbag1Writer(folder / "ros1.bag")
    bag1.set_compression(bag1.CompressionFormat.LZ4)
    with bag1:
        recorded["ros1"] = fill(bag1, 1)
    for name, plugin in (("sqlite", StoragePlugin.SQLITE3), ("mcap", StoragePlugin.MCAP)):
        with Rosbag2Writer(folder / name, version=9, storage_plugin=plugin) as bag2:
            recorded[name] = fill(bag2, 2)
    with open(folder / "bare.mcap", "wb") as stream:
        mcap = McapWriter(stream)
        mcap.start("ros2", "test")
        channels = {}
        for topic, kind, time, data in record(2, clouds):
            if topic not in channels:
                text = stores[2].generate_msgdef(kind, ros_version=2)[0].encode()
                channels[topic] = mcap.register_channel(
                    topic, "cdr", mcap.register_schema(kind, "ros2msg", text)
                )
            mcap.add_message(channels[topic], time, data, time - 5, 7)
        note = mcap.register_channel("/notes", "json", 0, {"by": "me"})
        mcap.add_message(note, START + 1, b'{"n": 1}', START, 3)
        # Names that an archive uses itself, twice the same name, a record that stands behind all chunks.
        mcap.add_attachment(5, START, "config.json", "text/plain", b"attached")
        mcap.add_metadata("salpcc", {"archive_version": "9", "b": "", "a": "é"})
        mcap.add_attachment(0, 0, "config.json", "", b"")
        mcap.add_metadata("calibration", {"log:crc": "0"})
        mcap.finish()
    recorded["bare"] = sorted([*recorded["mcap"], ("/notes", START + 1, b'{"n": 1}')])
    return recorded


def read(path: Path) -> Recorded:
    log = open_log(path)
    return sorted((log.channels[m.channel].topic, m.log_time, m.data) for m in log.messages())


def run_logs(root: Path, out: Path, names: list[str], **options: object) -> RunResult:
    config = RunConfig(source="bag", keep_movable=True, effort="fast", gop=2, **options)
    graph = GraphOptions(overwrite=True)
    return run_sequences(RunRequest(config, names, out, root, workers=0, graph=graph, quiet=True))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory, toy_root: Path) -> tuple[Path, dict[str, Recorded]]:
    """A folder with the same drive in four kinds of log, and the messages of each."""
    folder = tmp_path_factory.mktemp("logs")
    scans = [
        np.fromfile(toy_root / f"sequences/00/velodyne/{n:06d}.bin", "<f4").reshape(-1, 4) for n in range(3)
    ]
    clouds = {
        "/velodyne/points": [lattice_cloud(scan) for scan in scans],
        "/organised": [organised_cloud(n) for n in range(3)],
        "/map": [wide_cloud(n) for n in range(2)],
    }
    return folder, write_logs(folder, clouds)


@pytest.fixture(scope="module")
def logs(drive: tuple[Path, dict[str, Recorded]]) -> Path:
    return drive[0]


@pytest.fixture(scope="module")
def recorded(drive: tuple[Path, dict[str, Recorded]]) -> dict[str, Recorded]:
    return drive[1]


@pytest.fixture(scope="module")
def coded(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("coded")
    result = run_logs(logs, out, ["ros1", "sqlite", "mcap", "bare"])
    assert not result.failed
    return out


NAMES = ["ros1", "sqlite", "mcap", "bare"]


def test_logs_are_read_as_they_were_written(logs: Path, recorded: dict[str, Recorded]) -> None:
    assert Bag().sequences(logs) == sorted(NAMES)
    for name in NAMES:
        assert read(find_log(logs, name)) == recorded[name]


@pytest.mark.parametrize("name", NAMES)
def test_a_log_comes_back_byte_for_byte(
    name: str, coded: Path, recorded: dict[str, Recorded], tmp_path: Path
) -> None:
    archive = Archive.open(coded / "archives" / f"{name}.mcap")
    ros1 = name == "ros1"
    (path,) = EXPORTS["bag" if ros1 else "mcap"](archive, iter(archive), tmp_path)
    assert read(path) == recorded[name]
    with pytest.raises(UsageError, match="exists, and may be the log itself"):
        list(EXPORTS["bag" if ros1 else "mcap"](archive, iter(archive), tmp_path))


def test_clouds_of_several_sensors_make_no_map(coded: Path, tmp_path: Path) -> None:
    """Neither odometry nor poses of one of them would place the others; what is written would look like a map."""
    archive, poses = coded / "archives" / "bare.mcap", tmp_path / "poses.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 9)
    for given, said in (
        ([], "clouds of several topics"),
        ([str(poses)], r"several sensors \(map, organised"),
    ):
        with pytest.raises(SourceError, match=f"{said}.*cut --topic"):
            plan_map([archive], given)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("bare", "mcap recover"), ("ros1", "rosbag reindex"), ("sqlite", "sqlite3 FILE .recover")],
)
def test_a_log_that_was_cut_off_says_what_mends_it(
    name: str, remedy: str, logs: Path, tmp_path: Path
) -> None:
    source = find_log(logs, name)
    source = next(source.glob("*.db3")) if source.is_dir() else source
    cut = tmp_path / source.name
    cut.write_bytes(source.read_bytes()[: source.stat().st_size // 2])
    with pytest.raises(SourceError, match=f"{cut}: .*`{remedy}`"):
        read(cut)


@pytest.mark.parametrize(("name", "suffix"), [("bare", "mcap"), ("ros1", "bag")])
def test_a_log_of_another_name_is_told_which_one_it_needs(
    name: str, suffix: str, logs: Path, tmp_path: Path
) -> None:
    other = tmp_path / f"drive.{suffix.upper()}"
    shutil.copy(find_log(logs, name), other)
    with pytest.raises(SourceError, match=rf"but its name does not end in \.{suffix}; rename it"):
        find_log(other, "drive")


def facts(schema: Schema | None, channel: Channel, message: Message) -> tuple[object, ...]:
    told = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    times = message.log_time, message.publish_time, message.sequence
    return (
        channel.topic,
        channel.message_encoding,
        *times,
        message.data,
        *told,
        tuple(channel.metadata.items()),
    )


def test_publish_times_numbers_and_channels_of_mcap_come_back(
    logs: Path, coded: Path, tmp_path: Path
) -> None:
    archive = Archive.open(coded / "archives" / "bare.mcap")
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    found = []
    for file in (logs / "bare.mcap", path):
        with file.open("rb") as stream:
            found.append(sorted(facts(*row) for row in make_reader(stream).iter_messages()))
    assert found[0] == found[1]


def test_the_hash_of_a_type_comes_back_from_sqlite(coded: Path) -> None:
    facts = [
        dict(channel.metadata) for channel in Archive.open(coded / "archives" / "sqlite.mcap").log.values()
    ]
    assert len(facts) == 4 and all(one["topic_type_hash"].startswith("RIHS01_") for one in facts)


def enclosed(path: Path) -> list[object]:
    """Attachments and metadata of an MCAP file as mcap's own reader tells them."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        return [*reader.iter_attachments(), *reader.iter_metadata()]


@pytest.mark.parametrize(("name", "log"), [("bare", "mcap"), ("ros1", "bag")])
@pytest.mark.parametrize("form", ["kitti", "ply", "laz"])
def test_files_of_points_say_what_of_a_log_they_leave(
    coded: Path, tmp_path: Path, name: str, log: str, form: str
) -> None:
    told: list[str] = []
    archive = Archive.open(coded / "archives" / f"{name}.mcap")
    list(EXPORTS[form](archive, iter(archive), tmp_path, told.append))
    topics = "/notes, /texts" if name == "bare" else "/texts"
    assert f"messages of {topics} stay behind: --to {form} has no place for them, --to {log} has" in told
    enclosed = (
        f"attachments and metadata of the log stay behind: --to {form} has no place for them, --to mcap has"
    )
    assert (enclosed in told) == (name == "bare")
    rounded = [line for line in told if "float32: coordinates are rounded by up to 0.2" in line]
    assert len(rounded) == (form == "kitti")  # of the clouds in float64; intensities of 8 bits are none


def test_attachments_and_metadata_come_back(logs: Path, coded: Path, tmp_path: Path) -> None:
    archive = Archive.open(coded / "archives" / "bare.mcap")
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    assert enclosed(path) == enclosed(logs / "bare.mcap") and len(enclosed(path)) == 4
    assert archive.config["gop"] == 2 and archive.sequence == "bare"  # not theirs
    told = enclosed(coded / "archives" / "bare.mcap")  # other tools find them in the archive, too
    assert [one.name for one in told if one.name.startswith("log:")] == [  # type: ignore[attr-defined]
        *["log:config.json"] * 2, "log:salpcc", "log:calibration"
    ]  # fmt: skip


def test_what_of_an_mcap_file_does_not_come_back(logs: Path, coded: Path, tmp_path: Path) -> None:
    """As ``to_mcap`` says: chunks, their compression and the library in the header are the writer's own."""
    archive = Archive.open(coded / "archives" / "bare.mcap")
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    heads, summaries = [], []
    for file in (logs / "bare.mcap", path):
        with file.open("rb") as stream:
            reader = make_reader(stream)
            heads.append(reader.get_header())
            summaries.append(reader.get_summary())
    assert heads[0].profile == heads[1].profile == "ros2"
    assert (heads[0].library, heads[1].library) == ("test", "salpcc-pipeline")
    told = [
        (s.statistics.message_count, s.statistics.attachment_count, s.statistics.metadata_count)
        for s in summaries
    ]
    assert told[0] == told[1]


def test_decoding_says_what_ros2_cannot_hold(coded: Path, tmp_path: Path) -> None:
    said = {}
    for name, to in (("ros1", "mcap"), ("ros1", "bag"), ("sqlite", "mcap")):
        archive = str(coded / "archives" / f"{name}.mcap")
        done = CliRunner().invoke(app, ["decode", archive, "--to", to, "--out", str(tmp_path)])
        assert done.exit_code == 0
        said[name, to] = done.stderr
    assert said["ros1", "mcap"].count("header.seq") == 1
    assert said["ros1", "bag"] == said["sqlite", "mcap"] == ""


@pytest.mark.parametrize("name", ["ros1", "sqlite"])
def test_what_others_read_is_a_ros2_bag(
    name: str, coded: Path, recorded: dict[str, Recorded], tmp_path: Path
) -> None:
    archive = Archive.open(coded / "archives" / f"{name}.mcap")
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    clouds: dict[str, list[bytes]] = {}
    for bag in (path, path.parent):  # the bare file, and the folder with its metadata.yaml
        with AnyReader([bag]) as reader:
            messages = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
            assert reader.message_count == len(messages) == len(recorded[name])
        clouds = {}
        for topic, message in messages:
            if hasattr(message, "point_step"):
                clouds.setdefault(topic, []).append(message.data.tobytes())
    with path.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        times = [message.log_time for _, _, message, _ in decoded]
    assert len(times) == len(recorded[name])
    for topic, data in clouds.items():
        sources = [raw for source, _, raw in recorded["sqlite"] if source == topic]
        assert all(points in raw for points, raw in zip(data, sources, strict=True))


def test_reports_and_verifies_like_any_run(logs: Path, coded: Path) -> None:
    report = json.loads((coded / "report" / "report.json").read_text())
    figures = report["sequences"]["sqlite"]
    assert (figures["frames"], figures["bit_exact_scans"]) == (8, 8)
    assert figures["points_in"] == figures["points_decoded"]
    others = 3 * 800 * 32 + 2 * 300 * 33  # bytes of /organised and /map; the third topic has 16 a point
    assert figures["bytes_source"] == 16 * (figures["points_in"] - 3000) + others
    for name in NAMES:
        verdict = verify(coded / "archives" / f"{name}.mcap", find_log(logs, name))
        assert verdict.good and verdict.bit_exact_scans == 8
        assert verdict.passed_messages == (10 if name == "bare" else 9)


def test_a_second_run_goes_through_no_log(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []
    monkeypatch.setattr(bag_module, "digest_log", lambda path: read.append(path) or digest_log(path))
    monkeypatch.setattr(marks, "_REST", 0)
    went, walk = [], McapLog.messages
    monkeypatch.setattr(McapLog, "messages", lambda log, *wanted: went.append(1) or walk(log, *wanted))
    for topics, expected in (
        ((), 2),
        ((), 2),
        (("/map",), 4),
    ):  # to list clouds, to write what passes through
        assert not run_logs(logs, tmp_path, ["bare", "sqlite"], topics=topics).failed
        assert read == [logs / "bare.mcap", logs / "sqlite"] and len(went) == expected


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"text 1 2", "topic /texts: 1 messages are not those of the log"),
        (b"text 1 1", "attachments or metadata are not those of the log"),
    ],
)
def test_verify_finds_what_is_another(
    text: bytes, problem: str, logs: Path, coded: Path, tmp_path: Path
) -> None:
    """The log again without what it encloses, and with another text."""
    other, told = tmp_path / "bare.mcap", {}
    with (logs / "bare.mcap").open("rb") as source, other.open("wb") as stream:
        mcap = McapWriter(stream)
        mcap.start("ros2", "test")
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in told:
                number = mcap.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                facts = channel.topic, channel.message_encoding, number, channel.metadata
                told[channel.id] = mcap.register_channel(*facts)
            raw = message.data.replace(b"text 1 1", text)
            mcap.add_message(told[channel.id], message.log_time, raw, message.publish_time, message.sequence)
        mcap.finish()
    assert verify(coded / "archives" / "bare.mcap", other).problems[0] == problem


def test_a_bound_holds_and_the_topics_asked_for_are_coded(
    logs: Path, recorded: dict[str, Recorded], tmp_path: Path
) -> None:
    result = run_logs(logs, tmp_path, ["sqlite"], max_error=0.02, topics=("/organised", "/velodyne/points"))
    assert not result.failed and result.report is not None
    assert 0 < result.report["sequences"]["sqlite"]["max_error_m"] <= 0.02
    archive = Archive.open(tmp_path / "archives" / "sqlite.mcap")
    assert archive.names == [f"{t}-{n:06d}" for t, n in (("organised", 0), ("organised", 1), ("velodyne_points", 0),
                                                        ("velodyne_points", 1), ("organised", 2), ("velodyne_points", 2))]  # fmt: skip
    scan = archive[0]
    assert scan.cloud is not None and (scan.cloud.layout.height, scan.cloud.layout.width) == (8, 100)
    assert 0.1 < np.isnan(scan.points[:, 0]).mean() < 0.3
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    untouched = [row for row in recorded["sqlite"] if row[0] in ("/map", "/texts")]
    assert [row for row in read(path) if row[0] in ("/map", "/texts")] == untouched
    for kind in ("kitti", "ply", "laz"):
        assert len(list(EXPORTS[kind](archive, iter(archive), tmp_path))) == 6


def test_frames_of_a_log_say_what_of_other_topics_stays(logs: Path) -> None:
    part = RunConfig(source="bag", frames=(1, 2), topics=("/map", "/organised"))
    with pytest.warns(
        LogWarning, match=r"bare\.mcap: of /notes, /texts, /velodyne/points, only what was recorded"
    ):
        plan_run(logs, ["bare"], part)
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogWarning)
        plan_run(logs, ["sqlite"], RunConfig(source="bag"))


def test_a_cloud_that_cannot_be_read_passes_through(toy_root: Path, tmp_path: Path) -> None:
    scan = np.fromfile(toy_root / "sequences/00/velodyne/000000.bin", "<f4").reshape(-1, 4)[:500]
    good, odd = lattice_cloud(scan), {**lattice_cloud(scan), "fields": XYZI[:2]}
    recorded = write_logs(tmp_path, {"/points": [good, odd, good]})
    result = run_logs(tmp_path, tmp_path / "out", ["mcap"])
    (error,) = result.errors
    assert error.scan == "000001" and "no field z" in error.reason
    archive = Archive.open(tmp_path / "out" / "archives" / "mcap.mcap")
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path / "back")
    assert read(path) == recorded["mcap"]


def test_hostile_logs_give_one_clear_error(logs: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for name in NAMES:
        source = find_log(logs, name)
        path = tmp_path / source.name
        for number in range(12):
            shutil.rmtree(path, ignore_errors=True)
            path.unlink(missing_ok=True) if path.is_file() else None
            shutil.copytree(source, path) if source.is_dir() else shutil.copy(source, path)
            file = next(f for f in path.iterdir() if f.suffix != ".yaml") if path.is_dir() else path
            raw = bytearray(file.read_bytes())
            if number % 3 == 0:
                raw = raw[: rng.integers(0, len(raw))]
            else:
                for place in rng.integers(0, 4096 if number % 3 == 1 else len(raw), 4):
                    raw[place % len(raw)] ^= int(rng.integers(1, 256))
            file.write_bytes(raw)
            try:
                for ref in Bag().scans(tmp_path, name):
                    Bag().read(ref, with_labels=False)
            except SourceError as error:
                assert "\n" not in str(error).strip() and path.name in str(error)


def test_real_scans_come_back_from_every_kind_of_log(real_data: Path, tmp_path: Path) -> None:
    kitti = np.fromfile(real_data / "semantickitti/sequences/04/velodyne/000000.bin", "<f4").reshape(-1, 4)
    nuscenes = np.fromfile(real_data / "other_sensors/nuscenes_lidar_top.pcd.bin", "<f4").reshape(-1, 5)
    fields = (*XYZI, ("ring", 16, 7, 1))
    sweep = {
        "height": 1,
        "width": len(nuscenes),
        "fields": fields,
        "point_step": 20,
        "rows": nuscenes.view("u1"),
    }
    recorded = write_logs(tmp_path, {"/kitti": [lattice_cloud(kitti)], "/nuscenes": [sweep]})
    assert not run_logs(tmp_path, tmp_path / "out", ["ros1", "bare"]).failed
    for name in ("ros1", "bare"):
        archive = Archive.open(tmp_path / "out" / "archives" / f"{name}.mcap")
        assert sum(len(scan.cloud.rest) for scan in archive if scan.cloud) == len(kitti) + len(nuscenes)
        (path,) = EXPORTS["bag" if name == "ros1" else "mcap"](archive, iter(archive), tmp_path / "back")
        assert read(path) == recorded[name]


def test_a_calibrated_sensor_codes_its_log(tmp_path: Path) -> None:
    """``calibrate LOG``, then ``run log LOG --sensor FILE``: smaller, and every message comes back."""
    rng = np.random.default_rng(0)
    lasers, columns = 16, 256
    none = np.zeros(lasers)
    truth = SensorModel(
        "truth",
        1024,
        0.001,
        np.radians(np.linspace(12, -12, lasers)),
        none,
        none,
        none,
        none,
        none.astype(np.int64),
    )
    laser, tick = np.repeat(np.arange(lasers), columns), np.tile(np.arange(columns) * 4, lasers)
    clouds = []
    for _ in range(2):
        far = np.minimum(10 + 4 * np.sin(tick / 80), 1.7 / np.maximum(-np.sin(truth.theta[laser]), 0.02))
        count = np.rint((far + rng.normal(0, 0.01, len(tick))) / truth.count)
        points = np.zeros((len(tick), 4), "<f4")
        points[:, :3] = unproject(truth, laser.astype(np.uint8), tick.astype(np.int32), count)
        clouds.append({**lattice_cloud(points), "height": lasers, "width": columns})
    recorded = write_logs(tmp_path, {"/points": clouds})
    found = calibrate_log(tmp_path / "bare.mcap", 10, "mine")
    assert (found.fit.model.n_lasers, found.fit.model.count) == (lasers, 0.001)
    (tmp_path / "mine.json").write_text(found.fit.model.to_json())
    sizes = []
    for sensor in ("hdl64e", str(tmp_path / "mine.json")):
        out = tmp_path / f"out{len(sizes)}"
        assert not run_logs(tmp_path, out, ["bare"], sensor=sensor).failed
        archive = Archive.open(out / "archives" / "bare.mcap")
        sizes.append(sum(entry.geometry for gop in archive._reader.gops for entry in gop))
        (path,) = EXPORTS["mcap"](archive, iter(archive), out / "back")
        assert read(path) == recorded["bare"]
        assert verify(out / "archives" / "bare.mcap", tmp_path).good
    assert sizes[1] < 0.5 * sizes[0]
