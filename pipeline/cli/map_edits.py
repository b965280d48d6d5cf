"""``map edit``: what one does with maps that are there."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from salpcc.pipeline.cli.boxes import parse_box
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require

Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON to stdout.")]


def register(maps: typer.Typer) -> None:
    """Add the commands to those of ``map``."""
    maps.command(
        epilog="Examples:  `salpcc-pipeline map edit map --restore 17`  ·  "
        "`salpcc-pipeline map edit map --restore 10,-5,-2,14,3,2`"
    )(edit)


def edit(
    made: Annotated[Path, typer.Argument(metavar="MAP", help="A map that was made with --explain.")],
    restore: Annotated[
        list[str],
        typer.Option(
            metavar="BOX|ID",
            help="Put back what was removed in the box X0,Y0,Z0,X1,Y1,Z1, metres in the frame of the poses, as LAZ has it, "
            "or the object of this number in removed/objects.json; may be repeated.",
        ),
    ],
    json_: Json = False,
) -> None:
    """Put back into a map what was removed of it; its files are written anew, and map.json says what was done."""
    require("map", "map edit")
    from salpcc.pipeline.mapping.map_edit import Restored
    from salpcc.pipeline.mapping.map_edit import restore as put_back
    from salpcc.stages.mapping.tiles import Box

    numbers, boxes = [], []
    for text in restore:
        if text.isdecimal():
            numbers.append(int(text))
            continue
        values = parse_box("--restore", text)
        if not (len(values) == 6 and all(low < high for low, high in zip(values, values[3:], strict=False))):
            raise UsageError(
                f"--restore {text}: the number of an object, or six numbers x0,y0,z0,x1,y1,z1, the first three the lower ones"
            )
        boxes.append(Box.of(values))
    command = shlex.join(["salpcc-pipeline", *sys.argv[1:]])
    summary = put_back(made, Restored(tuple(numbers), tuple(boxes)), command)
    if json_:
        typer.echo(json.dumps(summary, indent=1))
        return
    typer.echo(
        f"{summary['edits'][-1]['voxels']} voxels put back; {summary['voxels']['kept']} voxels in "
        f"{len(summary['tiles'])} tiles\nmap: {made / 'tiles'}\nsummary: {made / 'map.json'}"
    )
