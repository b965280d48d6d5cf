"""Count the tables of effort ``fast`` over sweeps: a minute, no network, no chance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import UsageError
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.rans import TOTAL
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.hundredths import intensity_levels
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.static import intensities, levels
from salpcc.stages.predict.static.coder import contexts
from salpcc.stages.predict.static.count_tables import STEPS, StaticTables, check, save_tables, table_of
from salpcc.stages.predict.static.tokens import TOKENS, count_tokens

TRAINED_STEPS = (1, 2, 3, 5, 8, 10, 12, 15, 20, 30, 60)
_PRIOR = 8.0  # occurrences that the distribution over all contexts stands for

Counts = NDArray[np.int64]


def to_frequencies(counts: Counts) -> NDArray[np.uint16]:
    """Turn counts ``(C, A)`` into frequencies that add up to 4096. What rounds to 0 is left to the escape, the last."""
    overall = counts.sum(0) + 0.01
    wanted = counts + _PRIOR * overall / overall.sum()
    wanted *= TOTAL / wanted.sum(1, keepdims=True)
    frequency = np.rint(wanted).astype(np.int64)
    escaped = np.where(frequency[:, :-1] == 0, wanted[:, :-1], 0.0).sum(1) + wanted[:, -1]
    frequency[:, -1] = np.maximum(np.rint(escaped), 1)
    rows = np.arange(len(counts))
    frequency[rows, frequency.argmax(1)] += TOTAL - frequency.sum(1)
    return frequency.astype(np.uint16)


def count_tables(sweeps: Iterable[Sweep], sensor: SensorModel) -> tuple[Counts, Counts]:
    """Count tokens ``(4, C, TOKENS)`` and intensities ``(C, 102)`` of lossless sweeps, at all trained steps.

    Raises:
        UsageError: there are no sweeps.
    """
    tokens = np.zeros((len(STEPS), levels.CONTEXTS, TOKENS), np.int64)
    values = np.zeros((intensities.CONTEXTS, intensities.ESCAPE + 1), np.int64)
    for sweep in sweeps:
        starts = ring_starts(sweep.laser, sensor.n_lasers)
        for step in TRAINED_STEPS:
            level = (sweep.count // step).astype(np.int32)
            found = contexts(starts, sweep.tick, level, step, sensor)
            count_tokens(found.of_levels, found.residual, tokens[table_of(step)])
        known = intensity_levels(sweep.intensity)
        if known is not None:
            found = contexts(starts, sweep.tick, sweep.count, 1, sensor, known)
            np.add.at(values, (found.of_values, known), 1)
    if not tokens.any():
        raise UsageError("no scans to train on; name the root of some with --data")
    return tokens, values


def train_tables(sweeps: Iterable[Sweep], sensor: SensorModel, out: Path, log: Callable[[str], None]) -> Path:
    """Count the tables of effort ``fast`` and write ``fast.npz``."""
    tokens, values = count_tables(sweeps, sensor)
    log(f"tables: {tokens[0].sum()} returns at {len(TRAINED_STEPS)} steps")
    tables = StaticTables(np.stack([to_frequencies(counts) for counts in tokens]), to_frequencies(values))
    check(tables)
    out.mkdir(parents=True, exist_ok=True)
    save_tables(out / "fast.npz", tables)
    return out / "fast.npz"
