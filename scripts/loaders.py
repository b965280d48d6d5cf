"""Time ways to load scans, from plain files and from archives: ``python scripts/loaders.py OUT ROOT``.

OUT is the output of a run over sequences of ROOT, a folder of SemanticKITTI. Prints a table for docs/figures.md: time and CPU
time a scan, with all processes that work for it, and how many groups were decoded.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from torch import Generator, Tensor, from_numpy
from torch.utils.data import DataLoader, Dataset

from salpcc import Archive
from salpcc.pipeline.files.file_system import ArchiveFileSystem
from salpcc.torch import GroupSampler, ScanDataset, ScanStream


class Files(Dataset[dict[str, Tensor]]):
    """Scans and labels from files, of the disk or of a file system of fsspec."""

    def __init__(self, root: Path, names: list[tuple[str, str]], files: ArchiveFileSystem | None) -> None:
        self.root, self.names, self.files = root, names, files

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        sequence, name = self.names[index]
        folder = f"sequences/{sequence}"
        rows = np.frombuffer(self._read(f"{folder}/velodyne/{name}.bin"), np.float32).reshape(-1, 4)
        labels = np.frombuffer(self._read(f"{folder}/labels/{name}.label"), np.uint32)
        parts = rows[:, :3].copy(), rows[:, 3].copy(), (labels & 0xFFFF).astype(np.int64)
        return {
            key: from_numpy(part) for key, part in zip(("points", "intensity", "classes"), parts, strict=True)
        }

    def _read(self, name: str) -> bytes:
        return bytes(self.files.cat(name)) if self.files else (self.root / name).read_bytes()


def ways(archives: Path, root: Path) -> Iterator[tuple[str, Iterable[Any], Any]]:
    """Yield what is timed: its name, the loader, and what counts the groups that it decodes."""
    paths = sorted(archives.glob("*.mcap"))
    names = [(path.stem, name) for path in paths for name in Archive.open(path).names]
    random = Generator().manual_seed(0)
    options: dict[str, Any] = {"batch_size": None}
    plain = Files(root, names, None)
    yield "files, shuffled", DataLoader(plain, shuffle=True, generator=random, **options), None
    two = DataLoader(plain, shuffle=True, generator=random, num_workers=2, **options)
    yield "files, shuffled, 2 workers", two, None
    data = ScanDataset(paths)
    yield "`ScanDataset` in order", DataLoader(data, **options), data.decoded
    data = ScanDataset(paths)
    loader = DataLoader(data, sampler=GroupSampler(data), **options)
    yield "`ScanDataset`, `GroupSampler` of 4 groups", loader, data.decoded
    data = ScanDataset(paths)
    loader = DataLoader(data, shuffle=True, generator=random, **options)
    yield "`ScanDataset`, shuffled without regard to groups", loader, data.decoded
    stream = ScanStream(ScanDataset(paths))
    yield "`ScanStream` of 4 groups, 2 workers", DataLoader(stream, num_workers=2, **options), None
    files = ArchiveFileSystem(str(archives), skip_instance_cache=True)
    yield "`salpcc://` files in order", DataLoader(Files(root, names, files), **options), files.tree.groups


def cpu() -> float:
    """CPU seconds of this process and of those that it started and that have ended."""
    times = psutil.Process().cpu_times()
    return float(times.user + times.system + times.children_user + times.children_system)


def main(out: Path, root: Path) -> None:
    """Print the table."""
    first = ScanDataset(sorted((out / "archives").glob("*.mcap")))
    scans, groups = len(first), len(first.groups)
    first[0]  # whatever is compiled, is now
    print(
        f"| {scans} scans in {groups} groups | ms a scan | CPU ms a scan | groups decoded |\n|---|---:|---:|---:|"
    )
    for what, loader, counter in ways(out / "archives", root):
        start, before = time.perf_counter(), cpu()
        assert sum(1 for item in loader if len(item["points"])) == scans
        wall, work = (1e3 * seconds / scans for seconds in (time.perf_counter() - start, cpu() - before))
        print(f"| {what} | {wall:.1f} | {work:.1f} | {counter.decoded if counter else '-'} |")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: loaders.py OUT ROOT")
    main(Path(sys.argv[1]), Path(sys.argv[2]))
