"""The shard store and the lock."""

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pytest

from salpcc.pipeline.schedule import lock
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import LockedError, ShardError, UsageError
from salpcc.schemas.files import location, remove_tree

TABLE = pa.table({"a": [1, 2, 3]})


def test_shard_comes_back_with_its_facts(tmp_path: Path) -> None:
    store = ShardStore(tmp_path)
    ref = store.ref("04", "segment", 3, "ab" * 32)
    assert ref.path == "04/segment/00003-abababababababab.arrow" and not store.has(ref)
    store.write(ref, TABLE, {"stage": "segment"})
    table, facts = store.read(ref)
    assert table.to_pydict() == TABLE.to_pydict() and store.has(ref)
    assert facts["stage"] == "segment" and facts["digest"] == ref.digest and "salpcc" in facts["tool"]
    assert store.facts(ref) == facts


@pytest.mark.parametrize("content", [b"", b"ARROW1", b"x" * 1000])
def test_damaged_shard_names_itself(tmp_path: Path, content: bytes) -> None:
    store = ShardStore(tmp_path)
    ref = store.ref("04", "segment", 0, "0" * 64)
    store.write(ref, TABLE, {})
    (store.root / ref.path).write_bytes(content)
    with pytest.raises(ShardError, match=r"00000-0000000000000000\.arrow"):
        store.read(ref)


def test_flipped_bits_of_a_shard_are_found_and_it_is_made_again(tmp_path: Path) -> None:
    """Arrow and zstd have no checksums of their own: a shard's facts and content carry ours."""
    store = ShardStore(tmp_path)
    ref = store.ref("04", "segment", 0, "0" * 64)
    odd = {"s": ["a", None, "ccc"], "l": [[1.5], None, []], "b": [b"x", b"", None], "t": [True, None, False]}
    table = pa.table({**odd, "many": pa.array([list(range(500))] * 3)})
    store.write(ref, table, {"stage": "segment"})
    whole = (store.root / ref.path).read_bytes()
    same = 0
    for bit in range(3, 8 * len(whole), 97):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        (store.root / ref.path).write_bytes(damaged)
        try:
            found, facts = store.read(ref)
        except ShardError:
            assert not store.has(ref)  # so the next run makes it
        else:
            assert found.to_pydict() == table.to_pydict() and facts["stage"] == "segment"
            same += 1
    assert same < 8 * len(whole) // 97 // 2  # padding, and metadata that is there twice


def test_what_was_made_before_is_found_and_what_is_torn_is_to_be_made(tmp_path: Path) -> None:
    store = ShardStore(tmp_path)
    ref = store.ref("04", "segment", 3, "ab" * 32)
    assert store.found(ref) is None
    store.write(ref, TABLE, {"stage": "segment"})
    facts = store.found(ref)
    assert facts is not None and facts["stage"] == "segment" and facts == store.facts(ref)
    path = store.root / ref.path
    path.write_bytes(path.read_bytes()[:-9])
    assert store.found(ref) is None and not path.exists()


def test_missing_shard_names_itself(tmp_path: Path) -> None:
    store = ShardStore(tmp_path)
    with pytest.raises(ShardError, match=r"00000-0000000000000000\.arrow"):
        store.read(store.ref("04", "segment", 0, "0" * 64))


def test_half_written_files_are_swept_and_shards_dropped(tmp_path: Path) -> None:
    store = ShardStore(tmp_path)
    kept, gone = store.ref("04", "evaluate", 0, "1" * 64), store.ref("04", "segment", 0, "2" * 64)
    store.write(kept, TABLE, {})
    store.write(gone, TABLE, {})
    half = store.root / "04" / "segment" / ".x.arrow.123.part"
    half.write_bytes(b"half")
    store.sweep()
    assert not half.exists() and store.has(gone)
    store.drop_sequence("04", ["segment"])
    assert store.has(kept) and not store.has(gone)


def test_second_run_is_turned_away_and_the_lock_dies_with_its_process(tmp_path: Path) -> None:
    code = (
        "import sys, os\nfrom pathlib import Path\nfrom salpcc.pipeline.schedule.lock import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        with pytest.raises(LockedError, match=f"process {other.pid}"), locked(tmp_path):
            pass
        other.kill()
        other.wait()
    with locked(tmp_path):
        pass


def test_output_that_cannot_be_made_is_wrong_use(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot write"), locked(tmp_path / "file" / "out"):
        pass


@pytest.fixture
def url() -> Path:
    out = location("memory://locked")
    remove_tree(out)
    return out


def test_lock_behind_a_url_is_kept_alive_and_given_back(url: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "LEASE", 0.2)
    with locked(url):
        first = json.loads((url / ".lock").read_bytes())
        time.sleep(0.5)
        with pytest.raises(LockedError, match=f"process {os.getpid()} on"), locked(url):
            pass
        assert json.loads((url / ".lock").read_bytes())["seen"] > first["seen"]
    assert not (url / ".lock").exists()


@pytest.mark.parametrize(
    ("host", "seen", "free"),
    [("elsewhere", 0.0, True), ("elsewhere", 1.0, False), ("", 1.0, True)],
    ids=["silent", "alive", "died here"],
)
def test_lock_of_a_dead_run_behind_a_url_is_taken_over(
    host: str, seen: float, free: bool, url: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "_SETTLE", 0.0)
    gone = subprocess.Popen(["true"])
    gone.wait()
    holder = {
        "host": host or socket.gethostname(),
        "process": gone.pid,
        "token": "t",
        "seen": seen * time.time(),
    }
    (url / ".lock").write_bytes(json.dumps(holder).encode())
    if free:
        with locked(url):
            assert json.loads((url / ".lock").read_bytes())["process"] == os.getpid()
    else:
        with pytest.raises(LockedError, match="on elsewhere"), locked(url):
            pass
        assert json.loads((url / ".lock").read_bytes()) == holder
