"""Simulated vehicles and people, to be pasted into recorded scans: two scans each of a hundred streets.

Recorded scans hold cars by the hundred, but a handful of lorries and buses, so thirty of the streets are full of these;
and few of the walls, garages and guard rails that pass for lorries, so thirty others are full of those.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from salpcc.schemas.work import ScanRef
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.training.labelled import list_labelled

_STREETS = range(30, 130)  # names and seeds
_LARGE = range(70, 100)
_BESIDE = range(100, 130)
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
            if seed in _LARGE:
                config = replace(config, large=0.6, parked=0.5)
            if seed in _BESIDE:
                config = replace(config, large=0.6, parked=0.15, beside=0.6)
            simulate_sequence(config, part, sensor)
        part.rename(root)
    return list_labelled(root)
