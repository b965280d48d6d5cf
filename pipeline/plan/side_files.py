"""The files that lie with the scans of a sequence: which go into its archive, and whether they are there as they were.

Labels are coded scan by scan with the points. Small text files (calibration, poses, times, what the vehicle measured) go in
whole. Others stay behind, and a warning says so.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

from salpcc.schemas.errors import ArchiveError, LogWarning, SourceError
from salpcc.schemas.files import location, walk, why
from salpcc.schemas.work import ScanRef, SideRef
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import MOST_BYTES, SideFile, side_name

_MOST_IN_ALL = 4 * MOST_BYTES  # of the files of one sequence
# Never text, so they need not be opened.
_BINARY = frozenset(
    f".{kind}"
    for kind in (
        "bin",
        "label",
        "png",
        "jpg",
        "jpeg",
        "npy",
        "npz",
        "pcd",
        "ply",
        "las",
        "laz",
        "mcap",
        "bag",
        "db3",
        "zip",
        "gz",
        "xz",
        "zst",
        "tar",
        "h5",
        "pkl",
    )
)


def list_side(source: str, root: Path, sequence: str, scans: Iterable[ScanRef]) -> tuple[SideRef, ...]:
    """List the files that may be side files of a sequence; ``scans`` are all of it, which are none.

    Warns:
        LogWarning: what else lies there and stays behind.
    """
    folder = SOURCES[source].folder(root, sequence)
    if folder is None:
        return ()
    refs = list(scans)
    coded = {ref.path for ref in refs} | {ref.labels for ref in refs}
    found: list[SideRef] = []
    behind: dict[str, list[str]] = {}  # names, by what they begin with
    total = 0
    for name, path, size in walk(folder):
        if str(path) in coded:
            continue
        total += size
        if path.suffix.lower() in _BINARY or size > MOST_BYTES or total > _MOST_IN_ALL or not _good(name):
            total -= size
            behind.setdefault(name.partition("/")[0], []).append(name)
        else:
            found.append(SideRef(name, str(path)))
    if behind:
        what = ", ".join(
            f"{start} ({len(names)} files)" if len(names) > 1 else names[0]
            for start, names in sorted(behind.items())
        )
        warnings.warn(f"{folder}: no small text, so it stays behind: {what}", LogWarning, stacklevel=2)
    return tuple(found)


def _good(name: str) -> bool:
    try:
        return side_name(name) == name
    except ValueError:
        return False


def read_side(ref: SideRef) -> bytes:
    """Read a side file.

    Raises:
        SourceError: it cannot be read.
    """
    try:
        return location(ref.path).read_bytes()
    except OSError as error:
        raise SourceError(f"{ref.path}: {why(error)}; --no-side-files leaves such files out") from error


def side_files(refs: Iterable[SideRef]) -> Iterator[SideFile]:
    """Yield the side files for an archive.

    Raises:
        SourceError: one cannot be read, or is not what it was when the run began.
    """
    for ref in refs:
        data = read_side(ref)
        if ref.digest and hashlib.sha256(data).hexdigest() != ref.digest:
            raise SourceError(f"{ref.path}: changed during the run; run it again")
        yield SideFile(ref.name, data)


def unfit_labels(ref: ScanRef) -> SideRef | None:
    """Take a ``.label`` file that has not one label for each point of its scan for a side file, if it is small."""
    assert ref.labels is not None
    path = location(ref.labels)
    return SideRef(f"labels/{path.name}", ref.labels) if path.stat().st_size <= MOST_BYTES else None


def compare_side(reader: ArchiveReader, folder: Path | None, scans: Iterable[ScanRef]) -> list[str]:
    """Say which side files of an archive are not those of a folder; nothing where it has none, or they are the same.

    Args:
        scans: of the folder, which are no side files.
    """
    if folder is None or not (reader.side or reader.has_labels):
        return []
    coded = {path for ref in scans for path in (ref.path, ref.labels)}
    there = {name: path for name, path, _ in walk(folder) if str(path) not in coded or name in reader.side}
    problems = [f"side file {name}: not in {folder}" for name in reader.side if name not in there]
    for name in reader.side.keys() & there.keys():
        try:
            if reader.side_file(name).data != there[name].read_bytes():
                problems.append(f"side file {name}: differs from {there[name]}")
        except (ArchiveError, OSError) as error:
            problems.append(f"side file {name}: {error}")
    return problems
