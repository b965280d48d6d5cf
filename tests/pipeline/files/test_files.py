"""Archives as files: the tree, fsspec, FUSE, and the loaders of others, none of which is told about archives."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest
from typer.testing import CliRunner

from salpcc.pipeline import encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.files.file_system import ArchiveFileSystem
from salpcc.pipeline.files.tree import ArchiveTree
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.labels import classes_of_labels, labels_of_classes
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.mapping.open3d_library import load_open3d
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@pytest.fixture(scope="module", autouse=True)
def registered() -> None:
    """In a checkout that is not installed there is no entry point."""
    if "salpcc" not in fsspec.available_protocols():
        fsspec.register_implementation("salpcc", ArchiveFileSystem)


@pytest.fixture(scope="module")
def archives(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both toy sequences, classes and all, in groups of 2."""
    folder = tmp_path_factory.mktemp("archives")
    source = SOURCES["semantickitti"]
    for sequence in ("00", "01"):
        scans = [source.read(ref, True) for ref in source.scans(toy_root, sequence)]
        options: dict[str, Any] = {"labels": "given", "keep_movable": False, "effort": "fast", "gop": 2}
        encode_scans(scans, folder / f"{sequence}.mcap", sequence, **options)
    return folder


def test_the_tree_is_the_data_set(archives: Path, toy_root: Path) -> None:
    tree = ArchiveTree(archives)
    recorded = {str(p.relative_to(toy_root)) for p in toy_root.rglob("*") if p.is_file()}
    assert set(tree.files) == recorded
    assert list(tree.folders[""]) == ["sequences"] and set(tree.folders["sequences"]) == {"00", "01"}
    for name, file in tree.files.items():
        content = file.read()
        assert len(content) == file.size, name
        if name.endswith(".bin"):
            assert content == (toy_root / name).read_bytes()
        elif name.endswith(".label"):
            given = classes_of_labels(np.fromfile(toy_root / name, "<u4"))
            assert content == labels_of_classes(given).astype("<u4").tobytes()
    assert [float(line or "nan") for line in tree.files["sequences/00/times.txt"].read().split(b"\n")[:-1]] == [
        0.0, 0.1, 0.2, 0.3, 0.4,
    ]  # fmt: skip
    assert tree.groups.decoded == 5  # each group once: points and labels of a scan come together


def test_one_archive_and_one_layer(archives: Path, toy_root: Path, tmp_path: Path) -> None:
    both, static, movable = (
        ArchiveTree(archives / "00.mcap", layers) for layers in ("all", "static", "movable")
    )
    for name, file in both.files.items():
        if name.endswith((".bin", ".label")):
            assert file.size == static.files[name].size + movable.files[name].size
            assert len(static.files[name].read()) == static.files[name].size > 0
    with pytest.raises(UsageError, match="choose from"):
        ArchiveTree(archives, "moving")  # type: ignore[arg-type]
    with pytest.raises(ArchiveError, match="no archive"):
        ArchiveTree(tmp_path)
    (tmp_path / "a.mcap").write_bytes((archives / "00.mcap").read_bytes())
    (tmp_path / "b.mcap").write_bytes((archives / "00.mcap").read_bytes())
    with pytest.raises(UsageError, match="of sequence 00, as is"):
        ArchiveTree(tmp_path)


def test_through_fsspec(archives: Path, toy_root: Path) -> None:
    name = "sequences/00/velodyne/000003.bin"
    with fsspec.open(f"salpcc://{name}::file://{archives}") as stream:
        rows = np.frombuffer(stream.read(), np.float32).reshape(-1, 4)
    assert rows.tobytes() == (toy_root / name).read_bytes()
    files = fsspec.filesystem("salpcc", fo=str(archives))
    assert files is fsspec.filesystem("salpcc", fo=str(archives))  # with the groups that are decoded
    assert files.ls("sequences", detail=False) == ["sequences/00", "sequences/01"]
    assert files.glob("sequences/*/velodyne/000007.bin") == ["sequences/01/velodyne/000007.bin"]
    assert files.info(name)["size"] == rows.nbytes and files.isdir("/sequences/00/") and files.exists(name)
    assert len(files.find("")) == 18 and files.du("sequences/00/velodyne") == sum(
        path.stat().st_size for path in (toy_root / "sequences/00/velodyne").iterdir()
    )
    assert files.cat_file(name, 16, 32) == rows[1].tobytes() and files.tail(name, 4) == rows[-1, 3].tobytes()
    assert files.modified(name).timestamp() == pytest.approx(0.3)
    copy = pickle.loads(pickle.dumps(files))
    assert copy.cat(name) == rows.tobytes()
    for wrong, kind in (("sequences/09", FileNotFoundError), ("sequences", IsADirectoryError)):
        with pytest.raises(kind):
            files.cat_file(wrong)
    with pytest.raises(PermissionError, match="read-only"):
        files.open(name, "wb")


def test_any_order_decodes_few_groups_and_threads_may_ask(archives: Path, toy_root: Path) -> None:
    files = ArchiveFileSystem(str(archives), gops=2, skip_instance_cache=True)
    names = sorted(files.glob("sequences/*/velodyne/*.bin"))
    expected = {name: (toy_root / name).read_bytes() for name in names}
    with ThreadPoolExecutor(4) as pool:
        assert dict(zip(names, pool.map(files.cat_file, names), strict=True)) == expected
    before = files.tree.groups.decoded
    for name in reversed(names):  # from behind, a group at a time
        assert files.cat_file(name) == expected[name]
    assert files.tree.groups.decoded - before <= 5
    assert len(files.tree.groups._groups) == 2


def test_an_archive_that_is_replaced_is_read_anew(archives: Path, tmp_path: Path) -> None:
    path = tmp_path / "now.mcap"
    path.write_bytes((archives / "00.mcap").read_bytes())
    files = fsspec.filesystem("salpcc", fo=str(path))
    assert files.ls("sequences", detail=False) == ["sequences/00"]
    path.write_bytes((archives / "01.mcap").read_bytes())
    assert files.ls("sequences", detail=False) == ["sequences/01"]


def test_damage_is_told_and_whole_groups_are_read(archives: Path, tmp_path: Path) -> None:
    data = bytearray((archives / "00.mcap").read_bytes())
    chunks = ArchiveReader(archives / "00.mcap").layer_chunks()
    chunk = next(chunk for _, gop, chunk in chunks if gop == 1)
    at = chunk.chunk_start_offset + 4000
    data[at] ^= 1
    (tmp_path / "00.mcap").write_bytes(data)
    files = ArchiveFileSystem(str(tmp_path / "00.mcap"), skip_instance_cache=True)
    assert files.cat_file("sequences/00/velodyne/000000.bin")
    for _ in range(2):  # also when it is asked again
        with pytest.raises(ArchiveError, match="damaged"):
            files.cat_file("sequences/00/velodyne/000002.bin")
    assert files.cat_file("sequences/00/velodyne/000004.bin")


class KittiFolder:
    """A data set as the tools of SemanticKITTI read it: two lists of files, ``fromfile``, the lower half of labels."""

    def __init__(self, root: Path, sequence: str) -> None:
        folder = root / "sequences" / sequence
        self.scans, self.labels = (
            sorted(str(folder / kind / name) for name in os.listdir(folder / kind))
            for kind in ("velodyne", "labels")
        )
        assert len(self.scans) == len(self.labels)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        scan = np.fromfile(self.scans[index], dtype=np.float32).reshape((-1, 4))
        label = np.fromfile(self.labels[index], dtype=np.uint32).reshape(-1) & 0xFFFF
        if len(scan) != len(label):
            raise ValueError("scan and label do not fit")
        return scan, label


@pytest.fixture
def mounted(archives: Path, tmp_path: Path) -> Iterator[Path]:
    """The archives as a folder; skipped where there is no FUSE."""
    pytest.importorskip("mfusepy", exc_type=(ImportError, OSError))
    command = [sys.executable, "-m", "salpcc.pipeline.cli", "mount", str(archives), str(tmp_path / "at")]
    (tmp_path / "at").mkdir()
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        while not (tmp_path / "at" / "sequences").is_dir():
            if process.poll() is not None:
                assert process.stderr is not None
                said = process.stderr.read()
                assert process.returncode == 2 and "error: " in said
                pytest.skip(said)
            time.sleep(0.1)
        yield tmp_path / "at"
    finally:
        subprocess.run(["umount", str(tmp_path / "at")], check=False, capture_output=True)
        process.terminate()
        process.wait(20)


def test_loaders_read_a_mounted_folder(mounted: Path, toy_root: Path) -> None:
    """A loader of SemanticKITTI, Open3D's, and torch's, on what they take for plain files."""
    one, other = KittiFolder(toy_root, "00"), KittiFolder(mounted, "00")
    for (scan, label), (same, same_label) in zip(one, other, strict=True):  # type: ignore[call-overload]
        assert scan.tobytes() == same.tobytes()
        assert (classes_of_labels(label) == classes_of_labels(same_label)).all()
    path = mounted / "sequences" / "00" / "velodyne" / "000001.bin"
    assert path.stat().st_size == (toy_root / path.relative_to(mounted)).stat().st_size
    with pytest.raises(OSError):
        path.write_bytes(b"")
    assert (mounted / "sequences" / "00" / "times.txt").read_text().startswith("0.0")


def test_a_loader_of_semantickitti_through_fsspec(archives: Path, toy_root: Path) -> None:
    """The same lists and the same arrays, with the file system in place of ``os`` and ``open``."""
    files = fsspec.filesystem("salpcc", fo=str(archives))
    for sequence in ("00", "01"):
        folder = KittiFolder(toy_root, sequence)
        scans = sorted(files.ls(f"sequences/{sequence}/velodyne", detail=False))
        labels = sorted(files.ls(f"sequences/{sequence}/labels", detail=False))
        assert len(scans) == len(labels) == len(folder)
        for at in range(len(folder)):
            scan, label = folder[at]
            assert np.frombuffer(files.cat(scans[at]), np.float32).reshape(-1, 4).tobytes() == scan.tobytes()
            read = np.frombuffer(files.cat(labels[at]), np.uint32) & 0xFFFF
            assert (classes_of_labels(read) == classes_of_labels(label)).all()


def test_open3d_takes_the_points(archives: Path, toy_root: Path, open3d: None) -> None:
    o3d = load_open3d()
    files = fsspec.filesystem("salpcc", fo=str(archives))
    name = "sequences/01/velodyne/000007.bin"
    rows = np.frombuffer(files.cat(name), np.float32).reshape(-1, 4)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(rows[:, :3].copy()))
    given = np.fromfile(toy_root / name, np.float32).reshape(-1, 4)
    assert (cloud.point.positions.numpy() == given[:, :3]).all()


def test_mount_says_what_it_needs(archives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def command(*arguments: object) -> str:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert isinstance(result.exception, UsageError)
        return str(result.exception)

    assert "name an empty folder" in command("mount", archives, archives)
    assert "name an empty folder" in command("mount", archives, tmp_path / "none")

    def without(name: str) -> Any:
        raise OSError("Unable to find libfuse")

    monkeypatch.setattr("salpcc.pipeline.files.mount.import_module", without)
    assert "libfuse" in command("mount", archives, tmp_path)
