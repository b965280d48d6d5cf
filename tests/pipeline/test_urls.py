"""Runs on an object store (moto's, on loopback): the same bytes as in a folder, and what can go wrong with a URL."""

import json
import logging
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pytest
from mcap.writer import Writer
from moto.server import ThreadedMotoServer
from typer.testing import CliRunner

from salpcc.pipeline import Archive
from salpcc.pipeline.cli.app import app, main
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.graph import tasks
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LockedError, SalpccError, SourceError
from salpcc.schemas.files import atomic, location
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.stages.ingest.sources.bag import open_log

Run = Callable[..., RunResult]
KEEP = GraphOptions(keep_shards=True)
BUCKET = "s3://salpcc-test"
SECRET = "a-secret-key"


class Store:
    """An S3 server whose content outlives it."""

    def __init__(self) -> None:
        self.port = 0
        self.start()

    def start(self) -> None:
        self.server = ThreadedMotoServer("127.0.0.1", self.port, verbose=False)
        self.server.start()
        _, self.port = self.server.get_host_and_port()

    def stop(self) -> None:
        self.server.stop()


@pytest.fixture(scope="module")
def store(toy_root: Path) -> Iterator[Store]:
    """A store with the toy sequences in ``BUCKET/kitti``."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    store = Store()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{store.port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "somebody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
        patch.setenv("AWS_MAX_ATTEMPTS", "1")
        bucket = location(BUCKET)
        patch.setattr(bucket.fs, "retries", 1)  # type: ignore[attr-defined]
        bucket.fs.mkdir(BUCKET)  # type: ignore[attr-defined]
        for file in toy_root.rglob("*.*"):
            (bucket / "kitti" / str(file.relative_to(toy_root))).write_bytes(file.read_bytes())
        yield store
    store.stop()


@pytest.fixture(scope="module")
def fast(toy_root: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> Path:
    """The same run in a folder."""
    out = tmp_path_factory.mktemp("fast")
    assert not run(toy_root, out, "00", "01", effort="fast").failed
    return out


@pytest.fixture(scope="module")
def there(store: Store) -> Path:
    """Output of the command on the store, by a worker process."""
    options = ["--keep-movable", "--effort=fast", "--gop=2", "--workers=1", "--keep-shards"]
    done = cli("run", "sequences", "00,01", "--root", f"{BUCKET}/kitti", "--out", f"{BUCKET}/out", *options)
    assert done.returncode == 0, done.stderr
    return location(f"{BUCKET}/out")


def cli(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "salpcc.pipeline.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").iterdir()}


def test_a_store_gets_the_bytes_of_a_folder(there: Path, fast: Path) -> None:
    assert archives(there) == archives(fast) and len(archives(there)) == 2
    report = json.loads((there / "report" / "report.json").read_text())
    assert report["sequences"]["00"]["bit_exact_scans"] == 5
    figures = report["sequences"]["00"]
    beside = figures["labels"]["bytes"] + figures["side_files"]["bytes"]
    assert figures["bytes"]["total"] + beside == len(archives(fast)["00.mcap"])
    files = [path for path in there.rglob("*") if path.is_file()]
    assert not [path for path in files if path.name.startswith(".")]  # no lock, nothing half written
    assert not [path for path in files if SECRET.encode() in path.read_bytes()]
    shards = [path for path in files if path.suffix in (".arrow", ".mcap")]
    assert len(shards) > 20 and not [path for path in shards if b"s3://" in path.read_bytes()]


def test_archives_are_read_where_they_are(there: Path, toy_root: Path, tmp_path: Path) -> None:
    url = f"{there}/archives/00.mcap"
    verdict = verify(location(url), location(f"{BUCKET}/kitti"))
    assert verdict.good and verdict.bit_exact_scans == 5
    with Archive.open(url) as archive:
        assert [scan.name for scan in archive] == archive.names
        for out in (tmp_path, there / "back"):
            for path in EXPORTS["kitti"](archive, iter(archive), out):
                assert path.read_bytes() == (toy_root / "sequences/00/velodyne" / path.name).read_bytes()


def test_other_commands_take_urls(there: Path, fast: Path) -> None:
    (there / "report" / "index.html").unlink()
    archive, new = there / "archives" / "01.mcap", there / "new.mcap"
    for command in (
        ["report", str(there)],
        ["inspect", str(archive)],
        ["recover", str(archive), "--out", str(new)],
    ):
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
    assert (there / "report" / "index.html").is_file()
    assert new.read_bytes() == archives(fast)["01.mcap"]


def test_a_log_is_read_and_written_at_urls(store: Store, toy_root: Path) -> None:
    points = (toy_root / "sequences/01/velodyne/000000.bin").read_bytes()
    clouds = [CloudMessage(n, "lidar", len(points) // 16, points).to_cdr() for n in range(1, 4)]
    source, out = location(f"{BUCKET}/logs/drive.mcap"), location(f"{BUCKET}/coded")
    with atomic(source) as stream:
        mcap = Writer(stream)
        mcap.start("ros2", "test")
        schema = mcap.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        channel = mcap.register_channel("/points", "cdr", schema, {"offered_qos_profiles": ""})
        for time, cloud in enumerate(clouds):
            mcap.add_message(channel, time, cloud, time)
        mcap.finish()
    config = RunConfig(source="bag", keep_movable=True, effort="fast")
    assert not run_sequences(RunRequest(config, ["drive"], out, source, workers=0, quiet=True)).failed
    assert verify(out / "archives" / "drive.mcap", source).bit_exact_scans == 3
    with Archive.open(out / "archives" / "drive.mcap") as archive:
        (path,) = EXPORTS["mcap"](archive, iter(archive), out)
    back = open_log(location(str(path)))
    assert [message.data for message in back.messages()] == clouds
    (there := location(f"{BUCKET}/logs/drive.bag")).write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(SourceError, match="only MCAP is read from a URL"):
        open_log(there)


def test_two_runs_on_one_url_are_refused(there: Path, toy_root: Path, run: Run) -> None:
    with locked(there), pytest.raises(LockedError, match="another run"):
        run(toy_root, there, "00", effort="fast")
    assert not (there / ".lock").exists()


def test_an_open_archive_can_be_forked(there: Path) -> None:
    with Archive.open(there / "archives" / "01.mcap") as archive:
        points = archive[0].points
        with get_context("fork").Pool(1) as pool:
            assert (pool.apply_async(first_points, (archive,)).get(60) == points).all()


def first_points(archive: Archive) -> object:
    return archive[0].points


def test_what_is_gone_is_made_again_and_nothing_else(
    there: Path, fast: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (there / "archives" / "00.mcap").unlink()
    (shard,) = (there / "shards" / "00" / "residual_code").glob("00001-*.arrow")
    shard.unlink()
    made: list[int] = []
    stage = tasks.STAGES["residual_code"].run
    stages = {n: replace(s, run=None) for n, s in tasks.STAGES.items()}  # any other one that ran would break
    stages["residual_code"] = replace(
        tasks.STAGES["residual_code"], run=lambda *given: made.append(1) or stage(*given)
    )
    monkeypatch.setattr(tasks, "_warm", {"residual_code"})
    monkeypatch.setattr(tasks, "STAGES", stages)
    kitti = location(f"{BUCKET}/kitti")
    assert not run(kitti, there, "00", "01", effort="fast", graph=KEEP).failed
    assert made == [1] and archives(there) == archives(fast)


def test_a_lost_connection_is_one_line_and_the_run_goes_on(
    store: Store, fast: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    kitti, out = location(f"{BUCKET}/kitti"), location(f"{BUCKET}/torn")
    stage = tasks.STAGES["segment"].run

    def cut(*given: object) -> object:
        store.stop()
        return stage(*given)

    with monkeypatch.context() as patch:
        patch.setitem(tasks.STAGES, "segment", replace(tasks.STAGES["segment"], run=cut))
        with pytest.raises(SalpccError, match="run the same command again") as caught:
            run(kitti, out, "00", effort="fast")
    assert "\n" not in str(caught.value)
    store.start()
    assert not run(kitti, out, "00", effort="fast").failed
    assert archives(out)["00.mcap"] == archives(fast)["00.mcap"]


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (f"run sequences 00 --root {BUCKET}/kitti --out s3://missing/out", 2, "cannot write there"),
        (f"run sequences 00 --root {BUCKET}/nothing --out x", 2, "not found"),
        (f"run sequences 00 --source simulated --out {BUCKET}/out", 2, "name one with --root"),
        (f"run sequences 00 --root {BUCKET}/kitti --out memory://out", 2, "--workers 0"),
        (f"verify {BUCKET}/nothing.mcap", 1, "nothing.mcap: No such file"),
        ("verify nosuch://a/b.mcap", 2, "nosuch"),
        ("verify sftp://me:word@host/b.mcap", 2, "password"),
        (f"map {BUCKET}/out/archives/00.mcap --out m", 2, "map works in folders"),
    ],
)
def test_what_cannot_be_is_one_line(
    store: Store,
    command: str,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["salpcc-pipeline", *command.split()])
    with pytest.raises(SystemExit) as end:
        main()
    said = capsys.readouterr().err
    assert end.value.code == code and words in said and "me:word" not in said
    assert said.startswith("error: ") and said.count("\n") == 1, said
