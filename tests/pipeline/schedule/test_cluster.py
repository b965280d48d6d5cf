"""Many machines: a scheduler and worker processes of their own, on loopback."""

import errno
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest

from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.pipeline.schedule import cluster as cluster_module
from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.store import read_shard
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SalpccError, UsageError

DASK = [sys.executable, "-m", "dask"]
CONFIG = RunConfig(effort="fast", gop=1, keep_movable=True)


class Cluster:
    """``dask scheduler`` and ``dask worker``, as on machines of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder  # neither the client's nor the source's
        self.processes: list[subprocess.Popen[str]] = []
        self.start()

    def start(self, port: int = 0) -> None:
        said = self._start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        self.address = said(r"Scheduler at: +(tcp://\S+)")
        self.port = int(self.address.rsplit(":", 1)[1])

    def workers(self, count: int) -> None:
        for _ in range(count):
            self._start("worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny")

    def _start(self, *arguments: str) -> Callable[[str], str]:
        process = subprocess.Popen(
            [*DASK, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=self.folder
        )
        self.processes.append(process)

        def said(pattern: str) -> str:
            assert process.stderr is not None
            for line in process.stderr:
                if match := re.search(pattern, line):
                    return match[1]
            raise AssertionError(f"dask {arguments} ended")

        return said

    def end(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()
        self.processes = []


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    (tmp_path / "elsewhere").mkdir()
    cluster = Cluster(tmp_path / "elsewhere")
    yield cluster
    cluster.end()


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").glob("*.mcap")}


def spans(out: Path, sequence: str) -> list[tuple[float, float]]:
    """When each GOP of a sequence was begun and coded, by the times of its files."""
    first, last = (
        sorted((out / "shards" / sequence / stage).iterdir()) for stage in ("ingest", "residual_code")
    )
    return [(a.stat().st_mtime, b.stat().st_mtime) for a, b in zip(first, last, strict=True)]


def test_external_cluster_gives_the_same_bytes_and_may_lose_its_scheduler(
    cluster: Cluster,
    toy_root: Path,
    tmp_path: Path,
    run: Callable[..., RunResult],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cluster.workers(3)
    monkeypatch.chdir(tmp_path)  # relative paths are the client's
    root = Path(os.path.relpath(toy_root, tmp_path))
    keep = GraphOptions(keep_shards=True)
    request = RunRequest(CONFIG, ["00", "01"], Path("out"), root, None, cluster.address, keep, quiet=True)
    assert not run_sequences(request).failed
    assert not run(toy_root, tmp_path / "local", "00", "01", effort="fast", gop=1, graph=keep).failed
    assert archives(tmp_path / "out") == archives(tmp_path / "local")
    assert len(archives(tmp_path / "out")) == 2

    ends = [span for sequence in ("00", "01") for span in spans(tmp_path / "out", sequence)]
    assert max(sum(a <= begun < b for a, b in ends) for begun, _ in ends) <= 6  # two GOPs a thread at most
    early = (tmp_path / "local" / "archives" / "00.mcap").stat().st_mtime  # of one thread
    assert early < max(coded for _, coded in spans(tmp_path / "local", "01"))  # 00 did not wait for 01

    request = replace(request, out=tmp_path / "torn")
    begun = threading.Thread(target=end_when, args=(cluster, tmp_path / "torn" / "shards"))
    begun.start()
    with pytest.raises(SalpccError, match="scheduler is gone"):
        run_sequences(request)
    begun.join()
    with pytest.raises(UsageError, match="no answer"):
        run_sequences(request)
    cluster.start(cluster.port)
    cluster.workers(1)
    assert not run_sequences(request).failed
    assert archives(tmp_path / "torn") == archives(tmp_path / "local")


def end_when(cluster: Cluster, shards: Path) -> None:
    """Kill the scheduler in the middle of a run."""
    while not list(shards.rglob("*.arrow")):
        time.sleep(0.005)
    cluster.end()


def test_shards_say_nothing_of_the_machine(
    toy: Callable[..., Path], tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    """No path of the source or of the output is in any file that a run leaves, errors included."""
    root = toy(tmp_path / "root", "00", [0, 1])
    (root / "sequences/00/velodyne/000001.bin").write_bytes(b"odd")
    result = run(root, tmp_path / "out", "00", effort="fast", gop=2, graph=GraphOptions(keep_shards=True))
    assert [error.scan for error in result.errors] == ["000001"]
    files = [
        path
        for folder in ("shards", "archives", "records")
        for path in (tmp_path / "out" / folder).rglob("*.*")
    ]
    assert len(files) == 9
    for path in files:
        content = path.read_bytes()
        if path.suffix == ".arrow":
            table, facts = read_shard(path)
            content += repr((table.to_pydict(), facts)).encode()
        assert str(tmp_path).encode() not in content, path


@pytest.mark.parametrize("workers", [0, 1])
def test_only_this_machine_is_listened_to_and_the_dashboard_answers(workers: int) -> None:
    with connect(workers, None) as client:
        here = psutil.Process()
        listening = {
            connection.laddr.ip
            for process in (here, *here.children(recursive=True))
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        }
        assert listening == {"127.0.0.1"}
        with urlopen(client.dashboard_link, timeout=30) as answer:
            assert answer.status == 200
        if workers:  # have no pages to draw; a lambda, because workers do not know this file
            assert not any(client.run(lambda: "bokeh" in sys.modules).values())


def test_a_machine_without_processes_is_told_of_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks of processes lie in /dev/shm, which containers may lack."""

    def no_locks(**_: object) -> None:
        try:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        except OSError as error:
            raise RuntimeError("_Nanny failed to start.") from error

    monkeypatch.setattr(cluster_module, "LocalCluster", no_locks)
    said = r"worker \(Read-only file system; is /dev/shm writable\?\); --workers 0 goes without"
    with pytest.raises(UsageError, match=said), connect(1, None):
        pass
    with pytest.raises(RuntimeError, match="failed to start"), connect(0, None):  # nothing to go without
        pass
