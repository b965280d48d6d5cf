"""Simulated drives: SemanticKITTI layout, made on demand where the root does not hold them yet."""

from __future__ import annotations

import re
from pathlib import Path

from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti

DEFAULT_SCANS = 16


class Simulated(SemanticKitti):
    """A procedural street seen by a 64-laser sensor; needs no data of anybody."""

    name = "simulated"
    hint = "salpcc-pipeline simulate --out ROOT makes them"

    def make(self, root: Path, sequence: str, frames: int = DEFAULT_SCANS) -> list[ScanRef]:
        """Simulate ``sequence`` where ``root`` does not hold it, and list its scans.

        The street and the noise are seeded by the name, so a sequence is the same wherever it is made.
        """
        from salpcc.stages.ingest.simulator import write_sequence

        if not (root / "sequences" / sequence / "velodyne").is_dir():
            write_sequence(root, sequence, frames, seed_of(sequence))
        return self.scans(root, sequence)


def seed_of(sequence: str) -> int:
    """The number in the name; names without one are summed up by their characters."""
    digits = re.sub(r"\D", "", sequence)
    return int(digits) if digits else sum(ord(c) for c in sequence)
