"""Archives as the folders that their scans came from: ``sequences/04/velodyne/000000.bin`` and what is beside it.

The files are those that ``decode --to kitti`` writes, byte for byte; they are made when they are read. How long each is,
the index of the archive knows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from salpcc.pipeline.decode import DecodeOptions, Layers, check_layers
from salpcc.pipeline.decoded_groups import DecodedGroups
from salpcc.pipeline.files.kitti_files import label_bytes, scan_bytes, times_bytes
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.files import is_url
from salpcc.schemas.marks import marks
from salpcc.schemas.scan import Scan
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@dataclass(frozen=True)
class TreeFile:
    """A file of the tree: its length in bytes, when its scan was recorded (ns), and what reads it."""

    size: int
    time: int
    read: Callable[[], bytes]


class ArchiveTree:
    """The files of one archive, or of all in a folder, by their names below the root; read-only.

    Attributes:
        files: by name, such as ``sequences/04/velodyne/000000.bin``.
        folders: by name, ``""`` being the root, what is in each.
    """

    def __init__(self, path: Path, layers: Layers = "all", gops: int = 4) -> None:
        """List the files; nothing is decoded.

        Args:
            path: an archive, or a folder that holds archives.
            gops: groups of scans that stay decoded in memory.

        Raises:
            ArchiveError: one is damaged, or none is there.
            UsageError: there is no such layer, or two archives are of the same sequence.
        """
        self.groups = DecodedGroups(gops, DecodeOptions(layers, labels=True))
        self.files: dict[str, TreeFile] = {}
        self.folders: dict[str, dict[str, None]] = {"": {}}
        sequences: dict[str, Path] = {}
        archives = _archives(path)
        self._marks = marks({path, *archives}) if not is_url(path) else {}
        for archive in archives:
            reader = ArchiveReader(archive)
            check_layers(reader, layers)
            sequence = reader.facts.sequence
            if sequence in sequences:
                raise UsageError(
                    f"{archive}: of sequence {sequence}, as is {sequences[sequence]}; open one of them"
                )
            sequences[sequence] = archive
            for name, file in self._of(reader):
                self.files[f"sequences/{sequence}/{name}"] = file
        for name in self.files:
            self._list(name)

    def changed(self) -> bool:
        """Tell whether the archives are others than they were; of those behind a URL nobody asks again."""
        return marks(self._marks) != self._marks

    def _of(self, reader: ArchiveReader) -> Iterator[tuple[str, TreeFile]]:
        of_layers = {"all": reader.entries, "static": reader.gops, "movable": reader.movable_gops}
        columns = int(reader.facts.config.get("columns", 4))
        times: dict[str, int] = {}
        for gop, entries in enumerate(of_layers[self.groups.options.layers]):
            for place, (entry, time) in enumerate(zip(entries, reader.times(gop), strict=False)):
                times[entry.name] = time
                scan = partial(self.groups.scan, reader, gop, place)
                bin_ = partial(_points, scan, columns)
                yield f"velodyne/{entry.name}.bin", TreeFile(4 * columns * entry.kept, time, bin_)
                if entry.classes or entry.labels:
                    label = TreeFile(4 * entry.kept, time, partial(_labels, scan))
                    yield f"labels/{entry.name}.label", label
        if times and reader.side:
            for name in reader.side:  # small, and nothing but its content tells how long it is
                content = reader.side_file(name).data
                yield name, TreeFile(len(content), max(times.values()), partial(bytes, content))
        elif times and (text := times_bytes(times)):
            yield "times.txt", TreeFile(len(text), max(times.values()), lambda: text)

    def _list(self, name: str) -> None:
        while name:
            folder, _, last = name.rpartition("/")
            self.folders.setdefault(folder, {})[last] = None
            name = folder


def _points(scan: Callable[[], Scan], columns: int) -> bytes:
    return scan_bytes(scan(), columns)


def _labels(scan: Callable[[], Scan]) -> bytes:
    return label_bytes(scan()) or b""


def _archives(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix == ".mcap")
    if not found:
        raise ArchiveError(
            f"{path}: no archive (NAME.mcap) in this folder; a run writes them to OUT/archives"
        )
    return found
