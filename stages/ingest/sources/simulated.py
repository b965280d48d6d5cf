"""Simulated drives: SemanticKITTI layout, made on demand where the root does not hold them yet."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.lattice.sensor_model import load_sensor

DEFAULT_SCANS = 16


class Simulated(SemanticKitti):
    """A procedural street seen by a 64-laser sensor; needs no data of anybody."""

    name = "simulated"
    hint = "`salpcc-pipeline simulate --out ROOT` makes them"

    def make(
        self, root: Path, sequence: str, scans: int | None = None, sensor: str = "hdl64e"
    ) -> list[ScanRef]:
        """Simulate ``sequence`` where ``root`` holds fewer than ``scans`` of it, and list its scans.

        None takes whatever is there, else 16. Street and noise are seeded by the name, so a sequence is
        the same wherever it is made. It appears under its name only when complete.
        """
        from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence

        folder = root / "sequences" / sequence
        if (folder / "velodyne").is_dir():
            there = self.scans(root, sequence)
            if len(there) >= (scans or 1):
                return there
        part = root / f".simulating-{sequence}"
        shutil.rmtree(part, ignore_errors=True)
        config = SimulationConfig(sequence=sequence, scans=scans or DEFAULT_SCANS, seed=seed_of(sequence))
        simulate_sequence(config, part, load_sensor(sensor))
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        (part / "sequences" / sequence).rename(folder)
        shutil.rmtree(part)
        return self.scans(root, sequence)


def seed_of(sequence: str) -> int:
    """The number in the name; names without one are summed up by their characters."""
    digits = re.sub(r"\D", "", sequence)
    return int(digits) if digits else sum(ord(c) for c in sequence)
