"""An archive beside its source: the files or the log that it was made from, and where each of its points was there."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.plan.plan import check_original
from salpcc.schemas.config import GRID_ACCURACY
from salpcc.schemas.errors import ArchiveError, SourceError, UsageError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.measures.match import kept_points
from salpcc.stages.evaluate.measures.metrics import point_errors
from salpcc.stages.ingest.paper_grid import source_of
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.label_files import labels_that_fit
from salpcc.stages.residual_code.archive.reader import ArchiveReader


class Originals:
    """The scans that an archive was made from."""

    def __init__(self, reader: ArchiveReader, root: Path) -> None:
        """Find them below the root of their data, or in their log.

        Raises:
            UsageError: ``root`` is not there or holds none of them, or the archive was not made from files.
        """
        facts = reader.facts
        check_original(reader.path, facts.source, root)
        self._files = SOURCES[facts.source]
        self.root = root
        self._config = facts.config
        self._dropped = reader.movable == "dropped"
        columns = facts.config.get("columns", 4)
        try:
            refs = self._files.scans(root, facts.sequence)
            self.refs = {_key(ref.topic, ref.name): replace(ref, columns=columns) for ref in refs}
        except SourceError as error:
            raise UsageError(str(error)) from error

    def of(self, scan: Scan) -> tuple[Scan, str]:
        """Read the source of a decoded scan; return it with its labels, and where it is.

        Raises:
            SourceError: it is not there, or unreadable.
        """
        ref = self.refs.get(_key(scan.cloud.topic if scan.cloud else "", scan.name))
        if ref is None:
            raise SourceError(f"scan {scan.name}: not in {self.root}")
        source = self._files.read(ref, with_labels=self._config.get("labels") == "given")
        return replace(source, labels=labels_that_fit(ref, len(source))), ref.path

    def absent(self, held: Collection[str]) -> tuple[list[str], list[str]]:
        """Say which scans of files an archive of the scans ``held`` (by name) lacks: between its first and last, and outside."""
        numbers = [ref.number for name, ref in self.refs.items() if name in held]
        lacking = [(name, ref.number) for name, ref in self.refs.items() if name not in held]
        gaps = [name for name, number in lacking if numbers and numbers[0] < number < numbers[-1]]
        return gaps, [name for name, _ in lacking if name not in gaps]

    def errors(self, scan: Scan) -> NDArray[np.float64]:
        """Return how far each point of a decoded scan, or of one of its layers, is from its source: ``(N,)`` metres.

        Raises:
            SourceError: as :meth:`of`.
            ArchiveError: they are not its points.
        """
        source, path = self.of(scan)
        places = places_in_source(scan, source, self._config, self._dropped)
        if places is None:
            raise ArchiveError(f"scan {scan.name}: its {len(scan)} points are not those of {path}")
        return point_errors(source.points[places], scan.points).distance


def _key(topic: str, name: str) -> str:
    """A scan's name; of a message, its topic and number, as names depend on how many topics were coded."""
    return f"{topic} {name.rsplit('-')[-1]}" if topic else name


def places_in_source(
    scan: Scan, source: Scan, config: dict[str, Any], dropped: bool
) -> NDArray[np.int64] | None:
    """Return which source point each decoded point ``(N,)`` was; None where they are not points of this source.

    Args:
        config: that the archive was coded with.
        dropped: what may move is not in the archive.
    """
    if config.get("profile") == "paper":
        return source_of(scan, source, config.get("max_error") or GRID_ACCURACY)
    if config.get("labels") == "given" and dropped and source.classes is not None:
        kept = np.asarray(GROUP_OF_CLASS[source.classes] != MOVABLE)
    else:
        matched = kept_points(source, scan, max(bound for _, bound in bounds(scan, config)))
        if matched is None:
            return None
        kept = matched
    return np.flatnonzero(kept) if kept.sum() == len(scan) else None


def bounds(scan: Scan, config: dict[str, Any]) -> list[tuple[NDArray[np.bool_], float]]:
    """Which points ``(N,)`` of a scan were asked for with which error in metres, 0 for exact."""
    static, movable = config.get("max_error") or 0.0, config.get("movable_max_error")
    if scan.movable is None or movable is None:
        return [(np.ones(len(scan), np.bool_), static)]
    return [(~scan.movable, static), (scan.movable, movable)]
