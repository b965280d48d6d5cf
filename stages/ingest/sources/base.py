"""What a source is: the contract that every recorded layout fulfils (tests/stages/ingest/sources).

Where each scan is a file of its own, all but the first five methods are those of :class:`~.files.Files`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Protocol

from salpcc.schemas.config import RunConfig
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import Known, ScanRef


class Source(Protocol):
    """One layout of recorded scans on disk.

    ``hint`` is one sentence that says where such data come from; it is shown when they are missing. ``passes``: more than
    scans is recorded there, and passes through.
    """

    name: str
    hint: str
    passes: bool

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

    def there(self, root: Path) -> bool:
        """Tell whether ``root`` is what sequences may lie in."""
        ...

    def asked(self, root: Path, sequence: str, config: RunConfig, record: dict[str, Any]) -> list[ScanRef]:
        """List the scans of one sequence that a run asks for, whatever their frame number.

        Args:
            record: of the run before (``files``: :data:`~salpcc.schemas.work.Known`, ``places``: what :meth:`places` said).

        Raises:
            SourceError: as in :meth:`scans`.
        """
        ...

    def places(self, refs: Sequence[ScanRef]) -> dict[str, Any]:
        """Say what spares the next run to look for all scans of a sequence, as JSON has it; nothing where that is quick."""
        ...

    def recall(
        self, refs: Sequence[ScanRef], known: Known, config: RunConfig
    ) -> tuple[dict[str, str], Known]:
        """Return digests by path, and what is known by them: those on record that hold, and what all scans share.

        Raises:
            SourceError: what all scans share cannot be read.
        """
        ...

    def digest(self, ref: ScanRef, with_labels: bool) -> tuple[list[Any], Known]:
        """Return what decides the content of a scan, digests of what is read of it; and what was learned by reading that."""
        ...

    def passing(
        self, refs: Sequence[ScanRef], failed: Collection[str], frames: tuple[int, int] | None
    ) -> PassingLog | None:
        """Return what passes through beside the scans ``refs``, of which ``failed`` (by name) were not coded.

        Args:
            frames: that were asked for; then it is what lies between the first and the last scan.

        Raises:
            SourceError: it cannot be read.
        """
        ...
