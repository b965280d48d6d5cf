"""Tune the carving of a map on its own scans, on a worker."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from salpcc.pipeline.mapping.map_plan import Group
from salpcc.pipeline.mapping.map_scans import content_of, scans_of
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.config import Carving, MapConfig
from salpcc.stages.mapping.tune import Trial, tune

VERSION = 1
_TRIALS = pa.schema(
    [("views", pa.int64()), *((name, pa.float64()) for name in ("per_meeting", "margin", "sa", "da"))]
)


def tune_stretch(
    groups: Sequence[Group],
    names: frozenset[str],
    poses: tuple[float, ...],
    motions: tuple[float, ...],
    config: MapConfig,
    out: Path,
) -> ShardRef:
    """Try all settings on some scans, by ``names``, of a few groups, unless its shard is there; inverse of writing: :func:`read_trials`.

    Args:
        poses, motions: 16 and 6 numbers a scan.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
    """
    store = ShardStore(out)
    content = [content_of(group, config) for group in groups]
    digest = digest_of(VERSION, content, sorted(names), poses, motions, config.digest)
    ref = store.ref(groups[0].sequence, "tuning", groups[0].number, digest)
    if store.found(ref) is None:
        scans = [scan for group in groups for scan in scans_of(group, config, store) if scan.name in names]
        trials = tune(scans, np.array(poses).reshape(-1, 4, 4), np.array(motions).reshape(-1, 6), config)
        rows = [trial.carving.model_dump() | {"sa": trial.sa, "da": trial.da} for trial in trials]
        store.write(
            ref, pa.Table.from_pylist(rows, schema=_TRIALS), {"stage": "tuning", "stage_version": VERSION}
        )
    return ref


def read_trials(out: Path, ref: ShardRef) -> list[Trial]:
    """Read what was tried, the best first."""
    rows = ShardStore(out).read(ref)[0].to_pylist()
    return [
        Trial(Carving.model_validate({k: row[k] for k in Carving.model_fields}), row["sa"], row["da"])
        for row in rows
    ]


def trials_to_json(trials: Sequence[Trial]) -> list[dict[str, object]]:
    """Return what ``map.json`` says of what was tried."""
    return [
        {**trial.carving.model_dump(), "sa": trial.sa, "da": trial.da, "aa": trial.aa} for trial in trials
    ]
