"""``salpcc-pipeline run``: the main job."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from salpcc.pipeline.cli.summary import summary
from salpcc.pipeline.progress import STDERR, starting
from salpcc.schemas.config import UNBOUNDED, Coder, Effort, Labels, Profile, RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location
from salpcc.schemas.manifest import Manifest, expand_sequences, load_manifest
from salpcc.schemas.work import STAGES

if TYPE_CHECKING:
    from salpcc.pipeline.graph import GraphOptions
    from salpcc.pipeline.run import RunRequest, RunResult

app = typer.Typer(help="Encode recorded scans to archives, and report what it cost.", no_args_is_help=True)
DEFAULT_MANIFEST = Path("data_manifest.yaml")
PLACE = "DIR|URL"

# Panels of the help, in their order.
INPUT, KEPT, CODING, RUNNING = "Input and output", "What is kept", "Coding", "Running"

# Options that `run sequences` and `run log` share.
Out = Annotated[
    Path,
    typer.Option(
        parser=location, metavar=PLACE, help="Archives, report and shards go here.", rich_help_panel=INPUT
    ),
]
KeepMovable = Annotated[
    bool,
    typer.Option(
        "--keep-movable",
        help="Keep all in one layer, and ask no network what can move.",
        rich_help_panel=KEPT,
    ),
]
DropMovable = Annotated[
    bool,
    typer.Option(
        "--drop-movable",
        help="Leave out what can move, such as cars and people. [default: it has a layer of its own]",
        rich_help_panel=KEPT,
    ),
]
Classes = Annotated[
    bool,
    typer.Option("--classes", help="Store the classes that the network finds.", rich_help_panel=KEPT),
]
MaxError = Annotated[
    str | None,
    typer.Option(
        metavar="METRES",
        help="No point is farther than this from its source, in 3-D; static=METRES,movable=METRES for each layer; "
        "with --profile paper, the step of ranges. [default: bit-exact; 0.001]",
        rich_help_panel=KEPT,
    ),
]
Weights = Annotated[
    str,
    typer.Option(
        metavar="NAME|FILE",
        help="The network that tells what can move: a shipped width, or a file.",
        rich_help_panel=KEPT,
    ),
]
EffortLevel = Annotated[
    Effort, typer.Option(help="How hard to search for fewer bits.", rich_help_panel=CODING)
]
Gop = Annotated[
    int,
    typer.Option(metavar="SCANS", help="Scans that are coded as one group.", rich_help_panel=CODING),
]
Sensor = Annotated[
    str,
    typer.Option(
        metavar="NAME|FILE", help="The sensor's model: a shipped one, or a JSON file.", rich_help_panel=CODING
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        help="Processes to work in; 0 works in this one. [default: one per core]",
        rich_help_panel=RUNNING,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Work on the Dask cluster that runs there.",
        rich_help_panel=RUNNING,
    ),
]
FromStage = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="STAGE",
        help=f"Do this stage and all after it again: {', '.join(STAGES)}.",
        rich_help_panel=RUNNING,
    ),
]
ToStage = Annotated[
    str,
    typer.Option(
        "--to",
        metavar="STAGE",
        help="Stop after this stage, and keep its shards.",
        rich_help_panel=RUNNING,
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace archives in --out that were made in another way.",
        rich_help_panel=RUNNING,
    ),
]
KeepShards = Annotated[
    bool,
    typer.Option("--keep-shards", help="Keep what the stages hand to each other.", rich_help_panel=RUNNING),
]
Baselines = Annotated[
    str,
    typer.Option(
        metavar="NAME,NAME",
        help="Measure these other codecs, too; all and none are names.",
        rich_help_panel=RUNNING,
    ),
]
Device = Annotated[
    str,
    typer.Option(metavar="cpu|cuda", help="The networks that use torch run here.", rich_help_panel=RUNNING),
]
Json = Annotated[bool, typer.Option("--json", help="Print report.json to stdout.", rich_help_panel=RUNNING)]


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
    out: Out = Path("out"),
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
    max_error: MaxError = None,
    keep_movable: KeepMovable = False,
    drop_movable: DropMovable = False,
    classes: Classes = False,
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
    weights: Weights = "small",
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
    effort: EffortLevel = "default",
    coder: Annotated[
        Coder,
        typer.Option(
            metavar="NAME",
            help="It codes residuals with --profile paper: ppmd, zstd, lz4, bzip2, brotli, lzma2, lizard, lz5, "
            "deflate64, or our own context.",
            rich_help_panel=CODING,
        ),
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
        typer.Option(
            metavar="FILE",
            help="MPEG's program, for the baselines tmc13 and tmc13_octree. [default: the one on the PATH]",
            rich_help_panel=RUNNING,
        ),
    ] = None,
    device: Device = "cpu",
    json_: Json = False,
) -> None:
    """Encode sequences of scans, decode them again, measure, and write a report."""
    require("run", "run")
    with starting():
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


def parse_errors(text: str | None) -> dict[str, float | None]:
    """Parse ``--max-error``: metres, or metres by layer; what is not named is bit-exact."""
    try:
        if text is None or "=" not in text:
            return {"max_error": None if text is None else float(text)}
        by_layer = dict(part.split("=", 1) for part in text.split(","))
        if by_layer.keys() <= {"static", "movable"}:
            static, movable = (float(by_layer.get(name, 0.0)) for name in ("static", "movable"))
            return {"max_error": static or None, "movable_max_error": movable}
    except ValueError:
        pass
    raise UsageError(f"--max-error {text}: expected metres, such as 0.02, or static=0.02,movable=0")


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

    start = time.monotonic()
    result = run_sequences(request)
    _show(result, request.out, json_, request.sequences, time.monotonic() - start)
    raise typer.Exit(1 if result.failed else 0)


def _show(result: RunResult, out: Path, json_: bool, names: list[str], seconds: float) -> None:
    """Print what a run of the sequences ``names`` gave."""
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
    mine = [figures for name, figures in result.report["sequences"].items() if name in names]
    for line in summary(mine, seconds):
        console.print(line, highlight=False, soft_wrap=True)
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
