"""The stages that code a group of scans, in their order: the one table that the graph, ``encode_scans`` and the studies run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import PAYLOAD, PLANES, PREDICTION, SWEEP, TASK, sweeps_to_table
from salpcc.stages.ground_fit import stage as ground_fit
from salpcc.stages.ingest import stage as ingest
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.predict import stage as predict
from salpcc.stages.residual_code import stage as residual_code
from salpcc.stages.segment import stage as segment


@dataclass(frozen=True)
class Stage:
    """One stage: what runs, the stages whose tables it takes, and the table that it gives.

    Attributes:
        version: goes up when its tables change, so that shards of older code are made again.
        run: ``run(*tables, config)``; ingest takes the :class:`~salpcc.schemas.work.GopSource` instead of tables.
        schema: of its table in the profile ``sensor``.
    """

    name: str
    version: int
    run: Callable[..., pa.Table]
    inputs: tuple[str, ...]
    schema: pa.Schema


STAGES: dict[str, Stage] = {
    stage.name: stage
    for stage in (
        Stage("ingest", ingest.VERSION, ingest.run, (), SWEEP),
        Stage("segment", segment.VERSION, segment.run, ("ingest",), TASK),
        Stage("ground_fit", ground_fit.VERSION, ground_fit.run, ("segment",), PLANES),
        Stage("predict", predict.VERSION, predict.run, ("segment", "ground_fit"), PREDICTION),
        Stage(
            "residual_code",
            residual_code.VERSION,
            residual_code.run,
            ("segment", "ground_fit", "predict"),
            PAYLOAD,
        ),
    )
}


def code(
    scans: Iterable[tuple[int, Scan]], config: RunConfig, last: str = "residual_code"
) -> dict[str, pa.Table]:
    """Take one group of scans, each with its frame number, through the stages; return their tables by name.

    Args:
        last: stage to stop after.
    """
    project = ingest.Projector(load_sensor(config.sensor))
    made = {"ingest": sweeps_to_table([project(number, scan) for number, scan in scans])}
    for stage in STAGES.values():
        if stage.name not in made:
            made[stage.name] = stage.run(*(made[name] for name in stage.inputs), config)
        if stage.name == last:
            break
    return made
