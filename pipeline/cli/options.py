"""What commands share: arguments and options, how they are named and explained, and turned into a configuration."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer
from pydantic import BaseModel, ValidationError

from salpcc.schemas.config import UNBOUNDED, Effort
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import location
from salpcc.schemas.work import STAGES

if TYPE_CHECKING:
    from salpcc.pipeline.graph.graph import GraphOptions

PLACE = "DIR|URL"
BOX = "X0,Y0,Z0,X1,Y1,Z1"
Config = TypeVar("Config", bound=BaseModel)

Archive = Annotated[
    Path,
    typer.Argument(
        parser=location, metavar="ARCHIVE", help="An archive, such as OUT/archives/04.mcap, or its URL."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON to stdout.")]
Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Frames A to B - 1 only, by name or place.")]
Layers = Annotated[
    str,
    typer.Option(
        metavar="LAYERS", help="Which layers: all, static, or movable; static reads no byte of the other."
    ),
]

# Options of ``run``, and the panels of its help, in their order.
INPUT, KEPT, CODING, RUNNING = "Input and output", "What is kept", "Coding", "Running"

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
RunJson = Annotated[
    bool, typer.Option("--json", help="Print report.json to stdout.", rich_help_panel=RUNNING)
]


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


def command_line() -> str:
    """The command that is running, as it is typed."""
    return shlex.join(["salpcc-pipeline", *sys.argv[1:]])


def config_of(kind: type[Config], **values: object) -> Config:
    """Check options, named as in the configuration."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        option = f"--{first['loc'][0]}: ".replace("_", "-") if first["loc"] else ""  # several do not fit
        raise UsageError(option + first["msg"].removeprefix("Value error, ")) from error


def parse_box(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a box, metres in the frame of the poses; whoever takes them says what makes a box.

    Raises:
        UsageError: what is written are no numbers.
    """
    try:
        return tuple(float(value) for value in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: expected six numbers x0,y0,z0,x1,y1,z1 in metres") from error


def stages_of(first: str | None, last: str, keep: bool, overwrite: bool) -> GraphOptions:
    """Check how far a run goes."""
    from salpcc.pipeline.graph.graph import GraphOptions

    for option, stage in (("--from", first), ("--to", last)):
        if stage is not None and stage not in STAGES:
            raise UsageError(f"{option} {stage}: choose from {', '.join(STAGES)}")
    if first is not None and STAGES.index(first) > STAGES.index(last):
        raise UsageError(f"--from {first} --to {last}: the stages run the other way round")
    return GraphOptions(first or STAGES[0], last, first is not None, keep, overwrite)
