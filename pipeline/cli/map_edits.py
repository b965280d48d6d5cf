"""``map edit``: what one does with maps that are there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from salpcc.pipeline.cli.options import Json, command_line, parse_box
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require

_SHOWN = 20  # changes on the screen


def register(maps: typer.Typer) -> None:
    """Add the commands to those of ``map``."""
    maps.command(
        epilog="Examples:  `salpcc-pipeline map edit map --restore 17`  ·  "
        "`salpcc-pipeline map edit map --restore 10,-5,-2,14,3,2`"
    )(edit)
    maps.command(epilog="Example:  `salpcc-pipeline map diff monday tuesday --out changes`")(diff)


def diff(
    before: Annotated[
        Path, typer.Argument(metavar="A", help="The map of one session, with LAZ or PLY tiles.")
    ],
    after: Annotated[
        Path, typer.Argument(metavar="B", help="That of another one, its poses in the same frame.")
    ],
    out: Annotated[Path, typer.Option(help="Here go diff.json, a picture, and what changed, as LAZ.")],
    json_: Json = False,
) -> None:
    """Compare two maps of one place: objects that are gone, appeared, or stand elsewhere.

    What only one of the sessions could see is no change.
    """
    require("map", "map diff")
    from salpcc.pipeline.mapping.map_diff import diff as compare

    summary = compare(before, after, out)
    if json_:
        typer.echo(json.dumps(summary, indent=1))
        return
    table = Table(box=SIMPLE_HEAD)
    for column in ("change", "object", "class", "voxels", "x", "y", "z", "way, m"):
        table.add_column(column, justify="left" if column in ("change", "class") else "right")
    for row in summary["changes"][:_SHOWN]:
        middle = (f"{(low + high) / 2:.1f}" for low, high in zip(row["box"], row["box"][3:], strict=False))
        way = f"{row['way_m']:.1f}" if "way_m" in row else "-"
        table.add_row(row["change"], str(row["object"]), row["class"], str(row["voxels"]), *middle, way)
    if summary["changes"]:
        Console(emoji=False, markup=False).print(table)
    objects, unseen = summary["objects"], summary["voxels"]["after"]["not_seen_by_the_other"]
    more = max(0, len(summary["changes"]) - _SHOWN)
    typer.echo(
        ", ".join(f"{count} {kind}" for kind, count in objects.items())
        + (f" ({more} more in diff.json)" if more else "")
        + f"; {unseen} voxels of {after} are where {before} saw nothing; the maps lie {100 * summary['apart_m']:.1f} cm apart"
    )
    typer.echo(f"summary: {out / 'diff.json'}\npicture: {out / 'diff.png'}")


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
    summary = put_back(made, Restored(tuple(numbers), tuple(boxes)), command_line())
    if json_:
        typer.echo(json.dumps(summary, indent=1))
        return
    typer.echo(
        f"{summary['edits'][-1]['voxels']} voxels put back; {summary['voxels']['kept']} voxels in "
        f"{len(summary['tiles'])} tiles\nmap: {made / 'tiles'}\nsummary: {made / 'map.json'}"
    )
