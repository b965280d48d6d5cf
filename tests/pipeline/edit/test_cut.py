"""Parts of archives, and archives put together: what is copied stays byte for byte, the rest comes back bit for bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from typer.testing import CliRunner

from salpcc.pipeline import Archive, encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.edit.cut import Selection, cut
from salpcc.pipeline.edit.merge import merge
from salpcc.pipeline.edit.recover import recover
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive

GOLDEN = Path(__file__).parents[2] / "golden"
START = 1_600_000_000_000_000_000


@pytest.fixture(scope="module")
def scans(toy_root: Path) -> list[Scan]:
    source = SOURCES["semantickitti"]
    return [source.read(ref, True) for ref in source.scans(toy_root, "00")]


def encoded(scans: list[Scan], path: Path, **options: object) -> Path:
    return encode_scans(scans, path, "00", effort="fast", gop=3, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module", params=["layers", "one layer", "10 mm"])
def whole(
    request: pytest.FixtureRequest, scans: list[Scan], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """5 scans in groups of 3 and 2."""
    options = {
        "layers": {"labels": "given", "keep_movable": False},
        "one layer": {},
        "10 mm": {"max_error": 0.01},
    }
    return encoded(scans, tmp_path_factory.mktemp("whole") / "00.mcap", **options[request.param])


def same(one: Scan, other: Scan) -> bool:
    arrays = [(one.points, other.points), (one.intensity, other.intensity)]
    for name in ("classes", "movable"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None)
        arrays += [(mine, theirs)] if mine is not None else []
    return (one.name, one.time, one.frame_id) == (other.name, other.time, other.frame_id) and all(
        a.tobytes() == b.tobytes() for a, b in arrays
    )


@pytest.mark.parametrize(
    ("selection", "names", "copied"),
    [
        (Selection(frames=(0, 3)), [0, 1, 2], 3),  # a whole group
        (Selection(frames=(0, 2)), [0, 1], 2),  # the first of one
        (Selection(frames=(3, 9)), [3, 4], 2),
        (Selection(frames=(2, 5)), [2, 3, 4], 2),  # the end of one is coded anew
        (Selection(frames=(1, 2)), [1], 0),
        (Selection(seconds=(0.1, 0.35)), [1, 2, 3], 1),
        (Selection(seconds=(0.2, float("inf"))), [2, 3, 4], 2),
        (Selection(frames=(0, 4), seconds=(0.15, 9.0)), [2, 3], 1),
    ],
)
def test_parts(whole: Path, tmp_path: Path, selection: Selection, names: list[int], copied: int) -> None:
    counts = cut(whole, tmp_path / "part.mcap", selection)
    assert (counts.copied, counts.anew) == (copied, len(names) - copied)
    old, new = Archive.open(whole), Archive.open(tmp_path / "part.mcap")
    assert new.names == [f"{n:06d}" for n in names]
    assert all(same(old[scan.name], scan) for scan in new)
    assert new.movable == old.movable and verify(tmp_path / "part.mcap").good


def test_copied_groups_are_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    """Also, parts merged in any order are the archive again."""
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    cut(whole, first, Selection(frames=(0, 3)))
    cut(whole, second, Selection(frames=(3, 5)))
    old = ArchiveReader(whole)
    for gop, reader in enumerate((ArchiveReader(first), ArchiveReader(second))):
        assert [p.data for p in reader.payloads(0)] == [p.data for p in old.payloads(gop)]
        assert [p.data for p in reader.movable_payloads(0)] == [p.data for p in old.movable_payloads(gop)]
    merge([second, first], tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == whole.read_bytes()


def test_what_cannot_be_cut_or_merged(whole: Path, scans: list[Scan], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no scan of it is selected; it holds 000000 to 000004, 0.4 s"):
        cut(whole, tmp_path / "none.mcap", Selection(frames=(7, 9)))
    with pytest.raises(UsageError, match=r"topic /points is not in it \(topics: none"):
        cut(whole, tmp_path / "none.mcap", Selection(topics=("/points",)))
    with pytest.raises(UsageError, match="exists"):
        cut(whole, whole, Selection(frames=(0, 1)))
    with pytest.raises(UsageError, match=r"NAME\.mcap"):
        cut(whole, tmp_path / "part", Selection(frames=(0, 1)))
    with pytest.raises(UsageError, match="000000 is in"):
        merge([whole, whole], tmp_path / "none.mcap")
    other = encoded(scans[:1], tmp_path / "other.mcap", max_error=0.05)
    with pytest.raises(UsageError, match=r"max_error|otherwise"):
        merge([whole, other], tmp_path / "none.mcap")
    assert not (tmp_path / "none.mcap").exists()


def test_a_link_to_nothing_is_no_free_name(whole: Path, scans: list[Scan], tmp_path: Path) -> None:
    """It may lead to a disk that is not mounted; a new file would take its place."""
    link, folder = tmp_path / "link.mcap", tmp_path / "sequences/00/velodyne"
    folder.mkdir(parents=True)
    point = folder / "000000.bin"
    for name in (link, tmp_path / "00/00.mcap", point):
        name.parent.mkdir(exist_ok=True)
        name.symlink_to("/nowhere/there")
    archive = Archive.open(whole)
    for make in (
        lambda: cut(whole, link, Selection((0, 2))),
        lambda: merge([whole, whole], link),
        lambda: recover(whole, link),
        lambda: encode_scans(scans[:1], link),
        lambda: list(EXPORTS["mcap"](archive, iter(archive), tmp_path)),
        lambda: list(EXPORTS["kitti"](archive, iter(archive), tmp_path)),
    ):
        with pytest.raises(UsageError, match=r"exists|there"):
            make()
    assert link.is_symlink() and point.is_symlink() and (tmp_path / "00/00.mcap").is_symlink()


def test_groups_of_the_paper_are_taken_from_their_first_scan_on(tmp_path: Path) -> None:
    archive = GOLDEN / "nets" / "paper_ppmd.mcap"
    names = Archive.open(archive).names
    frames = (int(names[0]), int(names[0]) + 1)
    assert cut(archive, tmp_path / "first.mcap", Selection(frames=frames)).copied == 1
    last = int(names[len(ArchiveReader(archive).gops[0]) - 1])
    if last > int(names[0]):
        with pytest.raises(UsageError, match="from its first scan on"):
            cut(archive, tmp_path / "last.mcap", Selection(frames=(last, last + 1)))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, toy_root: Path) -> tuple[Path, Path]:
    """A log of two topics of clouds, 4 and 3, and a text every 50 ms; and its archive, in groups of 2."""
    folder = tmp_path_factory.mktemp("log")
    rows = np.fromfile(toy_root / "sequences/00/velodyne/000000.bin", "<f4").reshape(-1, 4)[:900]
    with open(folder / "drive.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        kind = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        of_topic = {topic: writer.register_channel(topic, "cdr", kind) for topic in ("/front", "/rear")}
        texts = writer.register_channel("/texts", "json", 0)
        for n in range(8):
            time = START + n * 50_000_000
            writer.add_message(texts, time - 1_000_000, b'{"n": %d}' % n, time, n)
            topic = "/front" if n % 2 == 0 else "/rear"
            if n < 7:
                cloud = CloudMessage(
                    time, topic[1:], len(rows), rows[::-1].tobytes() if n % 2 else rows.tobytes()
                )
                writer.add_message(of_topic[topic], time, cloud.to_cdr(), time, n)  # fmt: skip
        writer.add_attachment(0, 0, "notes", "text/plain", b"ours")
        writer.finish()
    config = RunConfig(source="bag", keep_movable=True, effort="fast", gop=2)
    request = RunRequest(config, ["drive"], folder / "out", folder / "drive.mcap", 0, graph=GraphOptions(), quiet=True)  # fmt: skip
    assert not run_sequences(request).failed
    return folder / "drive.mcap", folder / "out" / "archives" / "drive.mcap"


def told(path: Path) -> list[tuple[str, int]]:
    """Topic and time since the start in ms of all that an archive of a log holds."""
    archive = Archive.open(path)
    rows = [(scan.cloud.topic, scan.time) for scan in archive if scan.cloud]
    rows += [(archive.log[message.channel].topic, message.log_time) for message in archive.passing()]
    return sorted((topic, round((time - START) / 1e6)) for topic, time in rows)


def test_parts_of_logs(log: tuple[Path, Path], tmp_path: Path) -> None:
    """A message belongs to the last scan before it; parts put together are all of it, and of the log."""
    source, archive = log
    everything = told(archive)
    assert len(everything) == 15
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    cut(archive, first, Selection(seconds=(0.0, 0.12)))
    cut(archive, second, Selection(seconds=(0.12, 9.0)))
    assert told(first) == [row for row in everything if row[1] < 150]
    assert sorted(told(first) + told(second)) == everything
    for part in (first, second):
        assert verify(part, source).good
    merge([second, first], tmp_path / "again.mcap")
    assert told(tmp_path / "again.mcap") == everything
    assert [a.name for a in Archive.open(tmp_path / "again.mcap").enclosed()] == ["notes"]  # type: ignore[union-attr]


def test_parts_without_a_scan(log: tuple[Path, Path], tmp_path: Path) -> None:
    """Between two scans, or of topics that hold none, a part has messages only."""
    source, archive = log
    part, again = tmp_path / "part.mcap", tmp_path / "again.mcap"
    assert cut(archive, part, Selection(seconds=(0.04, 0.0495))).scans == 0
    assert told(part) == [("/texts", 49)]
    assert cut(archive, tmp_path / "texts.mcap", Selection(topics=("/texts",))).scans == 0
    assert told(tmp_path / "texts.mcap") == [row for row in told(archive) if row[0] == "/texts"]
    assert cut(tmp_path / "texts.mcap", again, Selection(seconds=(0.1, 0.2))).scans == 0
    assert told(again) == [("/texts", 99), ("/texts", 149)]
    for path in (part, tmp_path / "texts.mcap"):
        assert verify(path, source).good
    merge([part, tmp_path / "texts.mcap"], tmp_path / "both.mcap")
    assert told(tmp_path / "both.mcap") == told(tmp_path / "texts.mcap")
    run = CliRunner().invoke
    assert run(app, ["inspect", str(part)]).exit_code == 0
    assert run(app, ["decode", str(part), "--to", "mcap", "--out", str(tmp_path / "back")]).exit_code == 0
    with open(tmp_path / "back/drive/drive.mcap", "rb") as stream:
        assert [row.data for _, _, row in make_reader(stream).iter_messages()] == [b'{"n": 1}']
    failed = run(app, ["decode", str(part), "--to", "ply", "--out", str(tmp_path / "none")])
    assert failed.exit_code == 1 and "holds no scan" in str(failed.exception)
    for selection in (Selection((90, 99)), Selection(seconds=(90, 99)), Selection((90, 99), (0.04, 0.0495))):
        with pytest.raises(UsageError, match="no scan of it is selected, and no message"):
            cut(archive, tmp_path / "no.mcap", selection)


def test_topics_of_logs(log: tuple[Path, Path], tmp_path: Path) -> None:
    _, archive = log
    everything = told(archive)
    for number, topics in enumerate([("/front",), ("/rear", "/texts")]):
        part = tmp_path / f"{number}.mcap"
        cut(archive, part, Selection(topics=topics))
        assert told(part) == [row for row in everything if row[0] in topics]
        assert {channel.topic for channel in Archive.open(part).log.values()} == set(topics)
    with pytest.raises(UsageError, match=r"topic /left is not in it \(topics: /front, /rear, /texts\)"):
        cut(archive, tmp_path / "none.mcap", Selection(topics=("/left",)))


def test_two_logs_become_one(log: tuple[Path, Path], tmp_path: Path) -> None:
    """Clouds of the second go on counting; its channels are those that tell the same."""
    _, archive = log
    reader, later = ArchiveReader(archive), tmp_path / "later.mcap"
    gops = [
        [replace(payload, time=payload.time + 10**9) for payload in reader.payloads(gop)]
        for gop in range(len(reader.gops))
    ]
    texts = (replace(text, log_time=text.log_time + 10**9) for text in reader.passing())
    write_archive(later, reader.facts, gops, PassingLog(reader.log.values(), texts, reader.enclosed()))
    merge([archive, later], tmp_path / "both.mcap")
    names = Archive.open(tmp_path / "both.mcap").names
    assert len(names) == len(set(names)) == 14 and names[:7] == Archive.open(archive).names
    assert told(tmp_path / "both.mcap") == sorted(told(archive) + told(later))


def test_nothing_becomes_double(log: tuple[Path, Path], tmp_path: Path) -> None:
    """Parts of a log by topics share messages of others; clouds in two parts are refused, be they coded anew."""
    source, archive = log
    for topic in ("/front", "/rear"):
        cut(archive, tmp_path / f"{topic[1:]}.mcap", Selection(topics=(topic, "/texts")))
    merge([tmp_path / "rear.mcap", tmp_path / "front.mcap"], tmp_path / "both.mcap")
    assert told(tmp_path / "both.mcap") == told(archive) and verify(tmp_path / "both.mcap", source).good
    cut(archive, tmp_path / "first.mcap", Selection(frames=(0, 2)))
    cut(archive, tmp_path / "second.mcap", Selection(frames=(1, 9)))
    said = r"second.mcap: scan front-000001 is in .*first.mcap, too, as front-000001; cut one of them"
    with pytest.raises(UsageError, match=said):
        merge([tmp_path / "first.mcap", tmp_path / "second.mcap"], tmp_path / "none.mcap")
    with pytest.raises(UsageError, match="too, as front-000000"):
        merge([archive, archive], tmp_path / "none.mcap")
    assert not (tmp_path / "none.mcap").exists()


def test_find_says_which_messages_stay_behind(log: tuple[Path, Path], tmp_path: Path) -> None:
    out = log[1].parents[1]
    for target in ("found", "found.mcap"):
        command = ["find", str(out), "points > 0", "--export", str(tmp_path / target)]
        result = CliRunner().invoke(app, command)
        said = " ".join(result.stderr.split())
        assert result.exit_code == 0 and "7 copied; messages of /texts stay behind, which cut takes" in said


def test_parts_by_topics_of_which_one_has_several_publishers(log: tuple[Path, Path], tmp_path: Path) -> None:
    """Their channels keep their numbers, by which clouds know theirs."""
    _, archive = log
    reader = ArchiveReader(archive)
    channels = {c.topic: c for c in reader.log.values()}
    other = replace(channels["/front"], id=9, metadata=(("publisher", "2"),))
    parts = []
    for topic in ("/front", "/rear"):
        part = tmp_path / f"{topic[1:]}.mcap"
        cut(archive, part, Selection(topics=(topic,)))
        of = ArchiveReader(part)
        few = [*of.log.values(), *([other] if topic == "/front" else [])]
        write_archive(
            part, of.facts, [of.payloads(gop) for gop in range(len(of.gops))], PassingLog(few, iter(()), ())
        )
        parts.append(part)
    merge(parts, tmp_path / "both.mcap")
    assert ArchiveReader(tmp_path / "both.mcap").log == {
        c.id: c for c in (channels["/front"], channels["/rear"], other)
    }


def test_on_the_command_line(whole: Path, tmp_path: Path) -> None:
    def command(*arguments: object) -> tuple[int, str]:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        return result.exit_code, result.output + str(result.exception or "")

    part = tmp_path / "part.mcap"
    code, said = command("cut", whole, "--frames", "2:", "--out", part)
    assert code == 0 and said.startswith("3 scans, 2 copied, 1 coded anew and compared: ")
    code, said = command("cut", whole, "--time", ":0.15", "--out", tmp_path / "start.mcap")
    assert code == 0 and said.startswith("2 scans, 2 copied: ")
    code, said = command("merge", part, tmp_path / "start.mcap", "--out", tmp_path / "all.mcap")
    assert code == 0 and said.startswith("5 scans, 5 copied: ")
    for time in ("5", "2:1", "a:b", "nan:1"):
        code, said = command("cut", whole, "--time", time, "--out", tmp_path / "none.mcap")
        assert code == 1 and "write A:B" in said
    code, said = command("cut", whole, "--out", tmp_path / "none.mcap")
    assert code == 1 and "takes --frames, --time or --topic" in said
