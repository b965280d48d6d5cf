"""The Python door: indexing, iteration, pickling, forking, and no more decoding than needed."""

import multiprocessing
import pickle
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import salpcc.pipeline.decode as module
from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.schemas.errors import ArchiveError, KindError, UsageError
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.predict.learned import intensity_model, range_model
from salpcc.stages.predict.static.walk import walk


@pytest.fixture
def path(done: Path) -> Path:
    return done / "archives" / "00.mcap"  # five scans, two a GOP


def originals(root: Path, sequence: str) -> list[Scan]:
    source = SOURCES["semantickitti"]
    return [source.read(ref, with_labels=False) for ref in source.scans(root, sequence)]


def test_scans_come_back_bit_for_bit(path: Path, toy_root: Path) -> None:
    with Archive.open(path) as archive:
        assert len(archive) == 5 and archive.sequence == "00"
        for scan, source in zip(archive, originals(toy_root, "00"), strict=True):
            assert scan.points.tobytes() == source.points.tobytes()
            assert scan.intensity.tobytes() == source.intensity.tobytes()
            assert (scan.name, scan.time, scan.frame_id) == (source.name, source.time, "velodyne")


def test_indices_are_those_of_a_sequence(path: Path) -> None:
    archive = Archive.open(path)
    assert [archive[i].name for i in (3, 0, -1, 2)] == ["000003", "000000", "000004", "000002"]
    assert [scan.name for scan in archive[1:4]] == ["000001", "000002", "000003"]
    assert archive.names == ["000000", "000001", "000002", "000003", "000004"]
    for wrong in (5, -6):
        with pytest.raises(IndexError):
            archive[wrong]


def test_a_scan_is_found_by_its_name(path: Path) -> None:
    archive = Archive.open(path)
    assert archive["000003"].points.tobytes() == archive[3].points.tobytes()
    with pytest.raises(KeyError, match=r"000007 is not in .*; it holds 000000 to 000004"):
        archive["000007"]


def test_what_is_no_index_no_path_and_no_number_of_threads(path: Path, tmp_path: Path) -> None:
    archive = Archive.open(path)
    assert archive.names[1] in archive and "nobody" not in archive
    for wrong in (None, 1.0, b"000001", [1, 2], (1, 2)):
        with pytest.raises(KindError, match="by place, by name, or by a slice"):
            archive[wrong]  # type: ignore[call-overload]
    assert archive[np.int64(1)].name == archive.names[1]  # type: ignore[call-overload]
    for threads in (0, -1, "2", None):
        with pytest.raises(UsageError, match="threads"):
            Archive.open(path, threads=threads)  # type: ignore[arg-type]
    for nothing in (None, 3, b"a.mcap"):
        with pytest.raises(KindError, match="is no path"):
            Archive.open(nothing)  # type: ignore[arg-type]
    gone = tmp_path / "gone.mcap"
    gone.write_bytes(path.read_bytes())
    archive = Archive.open(gone)
    gone.unlink()
    with pytest.raises(ArchiveError, match=r"gone.mcap: No such file.*was there when it was opened"):
        archive[0]


def test_an_archive_is_a_sequence_that_can_be_closed(path: Path) -> None:
    archive = Archive.open(path)
    assert isinstance(archive, Sequence)
    assert [scan.name for scan in reversed(archive)] == archive.names[::-1]
    archive.close()
    archive.close()
    assert archive[0].name == "000000"  # no file was open, so it goes on


def test_what_a_notebook_shows(path: Path) -> None:
    archive = Archive.open(path)
    assert repr(archive) == f"Archive('00', 5 scans, hdl64e, {str(path)!r})"
    shown = archive._repr_html_()
    assert all(name in shown for name in archive.names) and f"{path.stat().st_size:,} bytes" in shown
    scan = archive[1]
    assert repr(scan) == f"Scan('000001', {len(scan):,} points, 0.100000 s, with labels)"
    assert f"<td>x</td><td>{scan.points[:, 0].min():.3f}</td>" in scan._repr_html_()
    odd = Scan("<b>", np.full((2, 3), np.nan, np.float32), np.array([1, np.inf], np.float32))
    assert "<b>" not in odd._repr_html_() and "<td>x</td>" not in odd._repr_html_()
    assert "<td>intensity</td><td>1.000</td><td>1.000</td>" in odd._repr_html_()
    empty = Scan("0", np.empty((0, 3), np.float32), np.empty(0, np.float32))
    assert "0 points" in empty._repr_html_()


def test_random_access_decodes_one_gop_at_most(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[bytes] = []
    real = module.decode_any

    def spy(payloads: Any, sensor: Any) -> Iterator[Any]:
        def counted() -> Iterator[bytes]:
            for payload in payloads:
                decoded.append(payload)
                yield payload

        return real(counted(), sensor)

    monkeypatch.setattr(module, "decode_any", spy)
    archive = Archive.open(path)
    assert len(decoded) == 0
    archive[3]
    assert len(decoded) == 2  # scans 2 and 3
    archive[2], archive[3]
    assert len(decoded) == 2  # both at hand
    archive[4]
    assert len(decoded) == 3


def test_archive_can_be_pickled_in_the_middle_of_a_gop(path: Path) -> None:
    archive = Archive.open(path)
    archive[2]
    copy = pickle.loads(pickle.dumps(archive))
    assert copy[3].points.tobytes() == archive[3].points.tobytes()


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_archive_works_in_other_processes(path: Path, method: str) -> None:
    archive = Archive.open(path)
    wanted = [archive[i].points.tobytes() for i in range(5)]
    context = multiprocessing.get_context(method)
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        found = list(pool.map(getitem, [archive] * 5, range(5)))
    assert [scan.points.tobytes() for scan in found] == wanted


def test_arrays_go_in_without_files(tmp_path: Path, toy_root: Path) -> None:
    scans = originals(toy_root, "01")
    path = encode_scans(iter(scans), tmp_path / "mine.mcap", gop=2)
    archive = Archive.open(path)
    assert [scan.points.tobytes() for scan in archive] == [scan.points.tobytes() for scan in scans]
    assert archive.config["gop"] == 2 and archive.names == ["000000", "000001", "000007"]


def test_arrays_of_any_sensor_keep_to_the_bound(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(0, 20, (500, 3)).astype(np.float32)
    scan = Scan("cloud", points, rng.random(500).astype(np.float32))
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap", max_error=0.02))
    error = np.linalg.norm(archive[0].points.astype(float) - points.astype(float), axis=1)
    assert len(archive[0]) == 500 and error.max() <= 0.02
    assert archive[0].intensity.tobytes() == scan.intensity.tobytes()


def test_damage_is_an_error_with_the_name_of_the_file(path: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    bad.write_bytes(data)
    with pytest.raises(ArchiveError, match=r"bad\.mcap"):
        list(Archive.open(bad))


def test_a_failed_decode_can_be_tried_again(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = Archive.open(path)
    with monkeypatch.context() as patch:
        patch.setattr(module, "decode_any", lambda payloads, sensor: iter(()))
        with pytest.raises(ArchiveError, match="000000 is missing"):
            archive[0]
    assert archive[0].name == "000000"


@pytest.mark.parametrize("threads", [2, 3, 8])
def test_threads_give_the_same_scans(path: Path, threads: int) -> None:
    alone = list(Archive.open(path))
    together = list(pickle.loads(pickle.dumps(Archive.open(path, threads=threads))))
    assert [(s.name, s.time, s.frame_id) for s in together] == [(s.name, s.time, s.frame_id) for s in alone]
    for one, other in zip(alone, together, strict=True):
        assert one.points.tobytes() == other.points.tobytes()
        assert one.intensity.tobytes() == other.intensity.tobytes()


@pytest.mark.parametrize("threads", [1, 3])
def test_a_broken_gop_ends_the_scans_where_it_breaks(
    path: Path, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    decode = module.decode_scans

    def breaks(reader: Any, gop: int, options: Any) -> Iterator[Scan]:
        scans = decode(reader, gop)
        yield next(scans)
        if gop == 1:
            raise ArchiveError("torn")
        yield from scans

    monkeypatch.setattr(module, "decode_scans", breaks)
    came = []
    with pytest.raises(ArchiveError, match="torn"):
        for scan in Archive.open(path, threads=threads):
            came.append(scan.name)
    assert came == Archive.open(path).names[:3]


def test_threads_decode_no_further_ahead_than_their_number(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = []

    def counted(reader: Any, gop: int, options: Any) -> Iterator[int]:
        begun.append(gop)
        yield gop

    monkeypatch.setattr(module, "decode_scans", counted)
    groups = module.decode_groups(Archive.open(path)._reader, range(100), threads=3)
    for gop in range(5):
        assert list(next(groups)) == [gop]
        assert len(begun) <= gop + 4
    groups.close()
    assert len(begun) <= 8


def test_the_heavy_kernels_run_without_the_lock_of_the_interpreter() -> None:
    for kernel in (range_model.walk, intensity_model.walk, walk):
        assert kernel.targetoptions["nogil"]
