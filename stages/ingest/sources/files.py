"""What sources have in common whose scans are files of their own."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from salpcc.schemas.config import RunConfig
from salpcc.schemas.files import location, reading, unreachable
from salpcc.schemas.marks import at_rest, mark, marks
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.work import Known, ScanRef
from salpcc.stages.ingest.sources.base import Source


class Files(Source):
    """A source of files: a scan each, with a file of labels or none; nothing passes through."""

    passes = False

    def there(self, root: Path) -> bool:
        """Tell whether ``root`` is a folder."""
        return root.is_dir()

    def asked(self, root: Path, sequence: str, config: RunConfig, record: dict[str, Any]) -> list[ScanRef]:
        """List the scans, with as many columns as they are said to have."""
        return [replace(ref, columns=config.columns) for ref in self.scans(root, sequence)]

    def places(self, refs: Sequence[ScanRef]) -> dict[str, Any]:
        """Return nothing: a folder is listed anew."""
        return {}

    def recall(
        self, refs: Sequence[ScanRef], known: Known, config: RunConfig
    ) -> tuple[dict[str, str], Known]:
        """Return the digests on record that hold; no file is read."""
        if not known:
            return {}, {}
        labels = {ref.labels for ref in refs if ref.labels and config.reads_labels(ref)}
        paths = [location(name) for name in sorted({ref.path for ref in refs} | labels)]
        found = {path: now for path, now in marks(paths).items() if known.get(path.name, ("", ""))[0] == now}
        still = {path.name: known[path.name] for path in found}
        return {str(path): known[path.name][1] for path in found}, still

    def digest(self, ref: ScanRef, with_labels: bool) -> tuple[list[Any], Known]:
        """SHA-256 of the files of a scan, each read if it is not known; and what was learned by that."""
        digests, learned = [], {}
        of_scan = ((ref.path, ref.digest), (ref.labels, ref.labels_digest))
        for path, known in of_scan[: 2 if with_labels else 1]:
            if path is None or known:
                digests.append(known or "absent")
                continue
            now, digest = _read(location(path))
            digests.append(digest)
            if now:
                learned[Path(path).name] = now, digest
        return digests, learned

    def passing(
        self, refs: Sequence[ScanRef], failed: Collection[str], frames: tuple[int, int] | None
    ) -> PassingLog | None:
        """Return None: files of scans hold nothing else."""
        return None


def _read(path: Path) -> tuple[str, str]:
    """The mark of a file, empty where it is not to be relied on, and its SHA-256, or a word for why there is none."""
    try:
        now = mark(path) if at_rest(path) else ""
        with reading(path) as stream:
            return now, hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:  # it will fail in ingest too, and be done again once it is readable
        if unreachable(error):
            raise
        return "", f"unreadable: {error.errno}"
