"""``salpcc-pipeline run sequences``: the main job."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Annotated

import typer

from salpcc.pipeline.cli import options
from salpcc.pipeline.cli.options import (
    CODING,
    INPUT,
    KEPT,
    PLACE,
    RUNNING,
    command_line,
    config_of,
    parse_errors,
    parse_frames,
    stages_of,
)
from salpcc.pipeline.cli.run_result import execute
from salpcc.pipeline.schedule.fork_server import start_fork_server
from salpcc.pipeline.schedule.progress import starting
from salpcc.schemas.config import Coder, Labels, Profile, RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location
from salpcc.schemas.manifest import Manifest, expand_sequences, load_manifest
from salpcc.schemas.work import STAGES

app = typer.Typer(help="Encode recorded scans to archives, and report what it cost.", no_args_is_help=True)
DEFAULT_MANIFEST = Path("data_manifest.yaml")


@app.command(
    epilog="Examples:  `salpcc-pipeline run sequences 00-07,09 --root DIR --keep-movable`  ·  "
    "`salpcc-pipeline run sequences 00,01 --source simulated --max-error 0.02 --out out`"
)
def sequences(
    names: Annotated[
        str,
        typer.Argument(
            metavar="SEQUENCES", help="Which ones: 04, or 00,04,07, or 11-21, or a split of the manifest."
        ),
    ],
    root: Annotated[
        Path | None,
        typer.Option(
            parser=location,
            metavar=PLACE,
            help="The data lie here. [default: the manifest's root]",
            rich_help_panel=INPUT,
        ),
    ] = None,
    out: options.Out = Path("out"),
    manifest: Annotated[
        Path,
        typer.Option(metavar="FILE", help="It names roots, sequences and splits.", rich_help_panel=INPUT),
    ] = DEFAULT_MANIFEST,
    source: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How the data are laid out: semantickitti, kitti_raw, bag; or simulated.",
            rich_help_panel=INPUT,
        ),
    ] = "semantickitti",
    max_error: options.MaxError = None,
    keep_movable: options.KeepMovable = False,
    drop_movable: options.DropMovable = False,
    classes: options.Classes = False,
    labels: Annotated[
        Labels,
        typer.Option(help="Ask the network what can move, or take .label files.", rich_help_panel=KEPT),
    ] = "network",
    side_files: Annotated[
        bool,
        typer.Option(
            help="Keep .label files, and the small text files of the sequence's folder.", rich_help_panel=KEPT
        ),
    ] = True,
    weights: options.Weights = "small",
    several_scans: Annotated[
        bool,
        typer.Option(help="Let the scans of a group settle their classes together.", rich_help_panel=KEPT),
    ] = True,
    columns: Annotated[
        int,
        typer.Option(
            metavar="4|5", help="Numbers a point in .bin files; nuScenes has 5.", rich_help_panel=INPUT
        ),
    ] = 4,
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Take frames A to B - 1 only.", rich_help_panel=INPUT),
    ] = None,
    profile: Annotated[
        Profile,
        typer.Option(help="Code on the sensor's lattice, or on the paper's grid.", rich_help_panel=CODING),
    ] = "sensor",
    effort: options.EffortLevel = "default",
    coder: Annotated[
        Coder,
        typer.Option(
            metavar="NAME",
            help="It codes residuals with --profile paper: ppmd, zstd, lz4, bzip2, brotli, lzma2, lizard, lz5, "
            "deflate64, or our own context.",
            rich_help_panel=CODING,
        ),
    ] = "ppmd",
    gop: options.Gop = 8,
    sensor: options.Sensor = "hdl64e",
    workers: options.Workers = None,
    scheduler: options.Scheduler = None,
    from_stage: options.FromStage = None,
    to_stage: options.ToStage = STAGES[-1],
    keep_shards: options.KeepShards = False,
    overwrite: options.Overwrite = False,
    baselines: options.Baselines = "none",
    tmc3: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="MPEG's program, for the baselines tmc13 and tmc13_octree. [default: the one on the PATH]",
            rich_help_panel=RUNNING,
        ),
    ] = None,
    device: options.Device = "cpu",
    json_: options.RunJson = False,
) -> None:
    """Encode sequences of scans, decode them again, measure, and write a report."""
    require("run", "run")
    asked = RunConfig.model_construct(labels=labels, keep_movable=keep_movable, classes=classes)
    start_fork_server(workers, scheduler, network=asked.uses_network)
    with starting():
        from salpcc.pipeline.run import RunRequest
        from salpcc.stages.evaluate.baselines import names as baseline_names
        from salpcc.stages.ingest.sources import SOURCES

    if source not in SOURCES:
        raise UsageError(f"--source {source}: choose from {', '.join(SOURCES)}")
    if tmc3 is not None:
        if shutil.which(tmc3) is None:
            raise UsageError(f"--tmc3 {tmc3}: no program there; name MPEG's tmc3")
        os.environ["SALPCC_TMC3"] = str(tmc3.resolve())  # the workers of this machine inherit it
    entry = _manifest(manifest).sources.get(source)
    if root is None and entry is not None and entry.root:
        root = location(entry.root)
    if root is None and source != "simulated":
        raise UsageError(
            f"--root is missing: where are the scans? {SOURCES[source].hint}. Or try it without data: --source simulated"
        )
    config = config_of(
        RunConfig,
        source=source,
        profile=profile,
        **parse_errors(max_error),
        keep_movable=keep_movable,
        drop_movable=drop_movable,
        classes=classes,
        labels=labels,
        side_files=side_files,
        weights=weights,
        several_scans=several_scans,
        effort=effort,
        coder=coder,
        gop=gop,
        sensor=sensor,
        columns=columns,
        frames=parse_frames(frames),
        baselines=baseline_names(baselines),
        device=device,
    )
    request = RunRequest(
        config=config,
        sequences=expand_sequences(names, entry.splits if entry else None),
        out=out,
        root=root,
        workers=workers,
        scheduler=scheduler,
        graph=stages_of(from_stage, to_stage, keep_shards, overwrite),
        command=command_line(),
    )
    execute(request, json_)


def _manifest(path: Path) -> Manifest:
    """Only a manifest that somebody asked for has to be there."""
    return Manifest() if path == DEFAULT_MANIFEST and not path.exists() else load_manifest(path)
