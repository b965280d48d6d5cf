"""``salpcc-pipeline run``: the main job."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from salpcc.pipeline.progress import STDERR
from salpcc.schemas.config import UNBOUNDED, Coder, Effort, Labels, Profile, RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location
from salpcc.schemas.manifest import Manifest, expand_sequences, load_manifest
from salpcc.schemas.work import STAGES

if TYPE_CHECKING:
    from salpcc.pipeline.graph import GraphOptions
    from salpcc.pipeline.run import RunRequest, RunResult

app = typer.Typer(help="Encode recorded scans to archives and report what it cost.", no_args_is_help=True)
DEFAULT_MANIFEST = Path("data_manifest.yaml")
PLACE = "DIR|URL"

# Options that `run sequences` and `run log` share.
Out = Annotated[
    Path, typer.Option(parser=location, metavar=PLACE, help="Archives, report and shards go here")
]
KeepMovable = Annotated[bool, typer.Option("--keep-movable", help="Keep movable objects")]
Weights = Annotated[str, typer.Option(help="Of the network: a shipped width, or a file")]
EffortLevel = Annotated[Effort, typer.Option(help="How hard to search for fewer bits")]
Gop = Annotated[int, typer.Option(help="Scans per group of pictures")]
Sensor = Annotated[str, typer.Option(help="Shipped sensor model, or a JSON file")]
Workers = Annotated[int | None, typer.Option(min=0, help="Processes; 0 is in-process [default: cores]")]
Scheduler = Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT", help="A running Dask cluster")]
FromStage = Annotated[str | None, typer.Option("--from", help=f"Redo from: {' | '.join(STAGES)}")]
ToStage = Annotated[str, typer.Option("--to", help="Stop after this stage, keeping its shards")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace archives in --out that were made otherwise")
]
KeepShards = Annotated[bool, typer.Option("--keep-shards", help="Keep intermediate shards")]
Baselines = Annotated[str, typer.Option(help="all | none | NAME,NAME")]
Device = Annotated[str, typer.Option(help="cpu | cuda, for the networks")]
Json = Annotated[bool, typer.Option("--json", help="Print report.json to stdout")]


@app.command(
    epilog="Examples:  `salpcc-pipeline run sequences 00-07,09 --root DIR --keep-movable`  ·  "
    "`salpcc-pipeline run sequences 00,01 --source simulated --max-error 0.02 --out out`"
)
def sequences(
    names: Annotated[
        str, typer.Argument(metavar="SEQUENCES", help="04 · 00,04,07 · 11-21 · a split of the manifest")
    ],
    root: Annotated[
        Path | None,
        typer.Option(
            parser=location, metavar=PLACE, help="Where the data lie [default: the manifest's root]"
        ),
    ] = None,
    out: Out = Path("out"),
    manifest: Annotated[Path, typer.Option(help="Sources, sequences, splits")] = DEFAULT_MANIFEST,
    source: Annotated[
        str, typer.Option(help="semantickitti | kitti_raw | simulated | bag")
    ] = "semantickitti",
    profile: Annotated[Profile, typer.Option(help="sensor lattice, or the paper's grid")] = "sensor",
    max_error: Annotated[
        float | None,
        typer.Option(
            help="Metres, 3-D, per point [default: bit-exact]; --profile paper: the range step [default: 0.001]"
        ),
    ] = None,
    keep_movable: KeepMovable = False,
    labels: Annotated[Labels, typer.Option(help="From the network, or from .label files")] = "network",
    weights: Weights = "small",
    several_scans: Annotated[
        bool, typer.Option(help="Let the scans of a group settle their classes together")
    ] = True,
    columns: Annotated[int, typer.Option(help="Numbers a point in .bin files; 5: nuScenes, with rings")] = 4,
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Frame numbers A to B - 1")] = None,
    effort: EffortLevel = "default",
    coder: Annotated[
        Coder,
        typer.Option(help="Of the residuals, with --profile paper: PPMd, the paper's others, or context"),
    ] = "ppmd",
    gop: Gop = 8,
    sensor: Sensor = "hdl64e",
    workers: Workers = None,
    scheduler: Scheduler = None,
    from_stage: FromStage = None,
    to_stage: ToStage = STAGES[-1],
    keep_shards: KeepShards = False,
    overwrite: Overwrite = False,
    baselines: Baselines = "none",
    tmc3: Annotated[
        Path | None,
        typer.Option(help="MPEG's program, for baselines tmc13… on this machine [default: on the PATH]"),
    ] = None,
    device: Device = "cpu",
    json_: Json = False,
) -> None:
    """Encode sequences of scans, decode them again, measure, report."""
    require("run", "run")
    from salpcc.pipeline.run import RunRequest
    from salpcc.stages.evaluate.baselines import names as baseline_names
    from salpcc.stages.ingest.sources import SOURCES

    if source not in SOURCES:
        raise UsageError(f"--source {source}: choose from {', '.join(SOURCES)}")
    if tmc3 is not None:
        if shutil.which(tmc3) is None:
            raise UsageError(f"--tmc3 {tmc3}: no program there")
        os.environ["SALPCC_TMC3"] = str(tmc3.resolve())  # the workers of this machine inherit it
    entry = _manifest(manifest).sources.get(source)
    if root is None and entry is not None and entry.root:
        root = location(entry.root)
    if root is None and source != "simulated":
        raise UsageError(
            f"--root is missing: where are the scans? {SOURCES[source].hint}. Or try it without data: --source simulated"
        )
    config = config_of(
        source=source,
        profile=profile,
        max_error=max_error,
        keep_movable=keep_movable,
        labels=labels,
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
        command=shlex.join(["salpcc-pipeline", *sys.argv[1:]]),
    )
    execute(request, json_)


def _manifest(path: Path) -> Manifest:
    """Only a manifest that somebody asked for has to be there."""
    return Manifest() if path == DEFAULT_MANIFEST and not path.exists() else load_manifest(path)


def parse_frames(text: str | None) -> tuple[int, int] | None:
    """Parse ``A:B``: frame numbers A to B - 1; either may be left out."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d*):(\d*)", text)
    if match is None:
        raise UsageError(f"--frames {text}: expected A:B, frame numbers A to B - 1, such as 0:100")
    return int(match[1] or 0), int(match[2] or UNBOUNDED)


def config_of(**values: object) -> RunConfig:
    """Check options, named as in the configuration."""
    try:
        return RunConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        option = str(first["loc"][0]).replace("_", "-") if first["loc"] else "options"
        raise UsageError(f"--{option}: {first['msg']}") from error


def stages_of(first: str | None, last: str, keep: bool, overwrite: bool) -> GraphOptions:
    """Check how far a run goes."""
    from salpcc.pipeline.graph import GraphOptions

    for option, stage in (("--from", first), ("--to", last)):
        if stage is not None and stage not in STAGES:
            raise UsageError(f"{option} {stage}: choose from {', '.join(STAGES)}")
    if first is not None and STAGES.index(first) > STAGES.index(last):
        raise UsageError(f"--from {first} --to {last}: the stages run the other way round")
    return GraphOptions(first or STAGES[0], last, first is not None, keep, overwrite)


def execute(request: RunRequest, json_: bool) -> None:
    """Run, print what it gave, leave with its exit code."""
    from salpcc.pipeline.run import run_sequences

    result = run_sequences(request)
    _show(result, request.out, json_)
    raise typer.Exit(1 if result.failed else 0)


def _show(result: RunResult, out: Path, json_: bool) -> None:
    """Print what a run gave."""
    for error in result.errors:
        STDERR.print(f"failed: {error.sequence}/{error.scan}: {error.reason}", soft_wrap=True, markup=False)
    if result.report is None:
        STDERR.print(f"stopped as asked; shards are in {out / 'shards'}", soft_wrap=True)
        return
    if json_:
        sys.stdout.write((out / "report" / "report.json").read_text())
        return
    console = Console()
    table = Table(title="bits per input point", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
    for column in (
        "sequence",
        "scans",
        "points",
        "geom.",
        "intens.",
        "total",
        "% raw",
        "max error",
        "fallback",
    ):
        table.add_column(column, justify="left" if column == "sequence" else "right", overflow="fold")
    for name, figures in result.report["sequences"].items():
        table.add_row(name, *_cells(figures))
    console.print(table)
    console.print(f"archives: {out / 'archives'}\nreport: {out / 'report' / 'index.html'}", soft_wrap=True)


def _cells(figures: dict[str, object]) -> list[str]:
    bpp = figures["bpp"]
    assert isinstance(bpp, dict)
    error = figures["max_error_m"]
    return [
        str(figures["frames"]),
        str(figures["points_in"]),
        *(f"{bpp[key]:.2f}" if bpp[key] is not None else "-" for key in ("geometry", "intensity", "total")),
        f"{figures['compression_rate_percent']:.2f}",
        "exact" if error == 0 else "-" if error is None else f"{1e3 * float(str(error)):.2f} mm",
        str(figures["points_on_fallback"]),
    ]
