"""Simulated vehicles and people, to be pasted into recorded scans: two scans each of forty streets."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from salpcc.schemas.work import ScanRef
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.training.labelled import list_labelled

_STREETS = range(30, 70)  # names and seeds; the shipped weights saw these
_SCENES = ("city", "suburb", "mixed")


def simulated_donors(
    root: Path, log: Callable[[str], None] = print, streets: range = _STREETS
) -> list[ScanRef]:
    """List the simulated scans in ``root``, in SemanticKITTI layout; they are made first where it is not there."""
    from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence

    if not root.exists():
        log(f"simulating {len(streets)} streets in {root}")
        part = root.with_name(f".{root.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        sensor = load_sensor("hdl64e")
        for seed in streets:
            scene = _SCENES[seed % len(_SCENES)]
            config = SimulationConfig(sequence=f"{seed:02d}", scans=2, seed=seed, scene=scene)
            simulate_sequence(config, part, sensor)
        part.rename(root)
    return list_labelled(root)
