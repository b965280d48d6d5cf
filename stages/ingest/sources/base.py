"""What a source is: the contract that every recorded layout fulfils (tests/stages/ingest/sources)."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef


class Source(Protocol):
    """One layout of recorded scans on disk.

    ``hint`` is one sentence that says where such data come from; it is shown when they are missing.
    """

    name: str
    hint: str

    def sequences(self, root: Path) -> list[str]:
        """List the names of the sequences below ``root``, sorted; empty where there are none."""
        ...

    def folder(self, root: Path, sequence: str) -> Path | None:
        """Return the folder whose other small files belong to the sequence, such as calibration and poses; None for none."""
        ...

    def scans(self, root: Path, sequence: str) -> list[ScanRef]:
        """List the scans of one sequence, ascending in frame number.

        Raises:
            SourceError: the sequence is not there, or holds no scans.
        """
        ...

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        """Read one scan: points in file order, and its classes where ``with_labels``.

        Raises:
            SourceError: a file is missing, truncated, or its labels do not match its points.
        """
        ...
