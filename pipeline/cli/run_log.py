"""``salpcc-pipeline run log``: the main job on a recorded log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salpcc.pipeline.cli import options
from salpcc.pipeline.cli.options import (
    CODING,
    INPUT,
    command_line,
    config_of,
    parse_errors,
    parse_frames,
    stages_of,
)
from salpcc.pipeline.cli.run_result import execute
from salpcc.pipeline.schedule.fork_server import start_fork_server
from salpcc.pipeline.schedule.progress import STDERR, starting
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import atomic, location
from salpcc.schemas.work import STAGES

if TYPE_CHECKING:
    from salpcc.stages.lattice.sensor_model import SensorModel


def register(app: typer.Typer) -> None:
    """Add the command to ``run``."""
    app.command(
        epilog="Examples:  `salpcc-pipeline run log drive.mcap --keep-movable`  ·  "
        "`salpcc-pipeline run log BAG_DIR --topic /front/points --topic /rear/points --max-error 0.02`"
    )(log)


def log(
    file: Annotated[
        Path,
        typer.Argument(
            parser=location,
            metavar="LOG",
            help="An .mcap, a ROS 1 .bag, a ROS 2 bag folder or its .db3; an .mcap may be a URL.",
        ),
    ],
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Code the point clouds of this topic; may be repeated. [default: all]",
            rich_help_panel=INPUT,
        ),
    ] = None,
    out: options.Out = Path("out"),
    max_error: options.MaxError = None,
    keep_movable: options.KeepMovable = False,
    drop_movable: options.DropMovable = False,
    classes: options.Classes = False,
    weights: options.Weights = "small",
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B",
            help="Take clouds A to B - 1 of each topic only, counted from 0.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    effort: options.EffortLevel = "default",
    gop: options.Gop = 8,
    sensor: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE|auto",
            help="The sensor's model, of whichever unit: a shipped one, a JSON file, or auto: the shipped one that the first clouds are of, whichever unit, else one that is calibrated on them.",
            rich_help_panel=CODING,
        ),
    ] = "auto",
    workers: options.Workers = None,
    scheduler: options.Scheduler = None,
    from_stage: options.FromStage = None,
    to_stage: options.ToStage = STAGES[-1],
    keep_shards: options.KeepShards = False,
    overwrite: options.Overwrite = False,
    baselines: options.Baselines = "none",
    device: options.Device = "cpu",
    json_: options.RunJson = False,
) -> None:
    """Encode the point clouds of a log, keep its other topics as they are, measure, and write a report."""
    require("run", "run")
    asked = RunConfig.model_construct(keep_movable=keep_movable, classes=classes)
    start_fork_server(workers, scheduler, network=asked.uses_network)
    with starting():
        from salpcc.pipeline.run import RunRequest
        from salpcc.pipeline.sensors.choose_sensor import AUTO, OWN, choose_sensor, choose_unit
        from salpcc.stages.evaluate.baselines import names as baseline_names
        from salpcc.stages.ingest.sources.bag import Bag, no_log
        from salpcc.stages.lattice.sensor_model import load_sensor

    if not file.exists():
        raise UsageError(f"{file}: not found. {Bag.hint}")
    names = Bag().sequences(file)
    if not names:
        raise UsageError(no_log(file))
    if len(names) > 1:
        raise UsageError(
            f"{file}: a folder of logs, and no bag without metadata.yaml; name one of {', '.join(names)}, "
            f"or let `ros2 bag reindex` make one bag of them"
        )
    # Before a sensor is sought: that may take a minute, and leaves a model in the output.
    config = config_of(
        RunConfig,
        source=Bag.name,
        **parse_errors(max_error),
        keep_movable=keep_movable,
        drop_movable=drop_movable,
        classes=classes,
        weights=weights,
        effort=effort,
        gop=gop,
        sensor=sensor,
        frames=parse_frames(frames),
        topics=tuple(topic or ()),
        baselines=baseline_names(baselines),
        device=device,
    )
    if sensor == AUTO:
        sensor, share, within, unit = choose_sensor(file, names[0], tuple(topic or ()))
        where = f"are within {1000 * within:g} mm of" if within else "lie on"
        found = "calibrated on the first clouds" if sensor == OWN else sensor
        told = (
            f"sensor: {found}, {share:.0%} of the returns of the first clouds {where} its lattice"
            if share
            else f"sensor: no shipped model fits, nor is one found; `salpcc-pipeline calibrate {file} --out sensor.json` may find one in more clouds"
        )
        if unit is not None:
            model = _written(unit, out, names[0])
            kind = "the model" if sensor == OWN else "it is another unit, whose model"
            sensor, told = str(model), f"{told}; {kind} is {model}"
        if share is not None:
            STDERR.print(told, soft_wrap=True, style="dim")
    elif (other := choose_unit(file, names[0], tuple(topic or ()), load_sensor(sensor))) and other.unit:
        model = _written(other.unit, out, names[0])
        told = f"sensor: the clouds are of another unit than {sensor}, {other.share:.0%} of the returns of the first ones lie on the lattice of {model}"
        STDERR.print(told, soft_wrap=True, style="dim")
        sensor = str(model)
    request = RunRequest(
        config=config.model_copy(update={"sensor": sensor}),
        sequences=names,
        out=out,
        root=file,
        workers=workers,
        scheduler=scheduler,
        graph=stages_of(from_stage, to_stage, keep_shards, overwrite),
        command=command_line(),
    )
    execute(request, json_)


def _written(model: SensorModel, out: Path, name: str) -> Path:
    """Write the model of a log's own sensor into the output folder."""
    file = out / "sensors" / f"{name}.json"
    with atomic(file) as stream:
        stream.write(model.to_json().encode())
    return file
