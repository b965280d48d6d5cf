"""``find``, ``cut``, ``merge``, ``mount``, ``view``: what one takes from archives, and puts together."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from salpcc.pipeline.cli import options
from salpcc.pipeline.cli.options import PLACE, parse_frames
from salpcc.pipeline.schedule.progress import STDERR
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location

if TYPE_CHECKING:
    import pyarrow as pa

    from salpcc.pipeline.decode import Layers

New = Annotated[
    Path,
    typer.Option(parser=location, metavar="FILE|URL", help="The new archive; nothing is overwritten."),
]
_SHOWN = ("sequence", "name", "time", "points", "speed")  # and what the condition names


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command(
        epilog="Example:  `salpcc-pipeline find out 'person > 50 and speed < 1' --export people`  ·  columns: points, "
        "static, movable, ground, other, every class (person, car, other_vehicle, …), speed (m/s), yaw_rate (rad/s), "
        "bits (a point), bytes, silent_lasers, laser_excess (bits that a sick laser costs more), fallback, name, sequence, time (ns), gop and more, which a mistake in the condition lists"
    )(find)
    app.command(
        epilog="Examples:  `salpcc-pipeline cut out/archives/04.mcap --frames 100:200 --out part.mcap`  ·  "
        "`salpcc-pipeline cut out/archives/drive.mcap --time 60:90.5 --topic /front/points --out part.mcap`"
    )(cut)
    app.command(epilog="Example:  `salpcc-pipeline merge first.mcap second.mcap --out whole.mcap`")(merge)
    app.command(epilog="Example:  `salpcc-pipeline mount out/archives /mnt/scans`")(mount)
    app.command(
        epilog="Examples:  `salpcc-pipeline view out/archives/04.mcap`  ·  `salpcc-pipeline view map --save map.rrd`"
    )(view)


def find(
    out: Annotated[
        Path, typer.Argument(parser=location, metavar="OUT", help="The --out of runs, or its catalogue.")
    ],
    condition: Annotated[
        str, typer.Argument(metavar="CONDITION", help="Which scans, as a condition of SQL over the columns.")
    ],
    export: Annotated[
        Path | None,
        typer.Option(
            parser=location,
            metavar="DIR|FILE",
            help="Write the scans that are found to archives: one a sequence in DIR, or one FILE.mcap of all.",
        ),
    ] = None,
    json_: options.Json = False,
) -> None:
    """Find scans in the catalogue that runs leave: by what was seen, by motion, size, or any other column."""
    from salpcc.pipeline.find.catalogue import read_catalogue
    from salpcc.pipeline.find.find import find as find_scans
    from salpcc.pipeline.find.find import named_columns, not_known

    folder = out.parent if out.suffix == ".parquet" else out
    catalogue = read_catalogue(folder)
    found = find_scans(catalogue, condition)
    if json_:
        typer.echo(json.dumps(found.to_pylist(), indent=1))
    else:
        named = [name for name in named_columns(catalogue, condition) if name not in _SHOWN]
        for line in _lines(found, [*_SHOWN, *named]):
            typer.echo(line)
        STDERR.print(f"{len(found):,} of {len(catalogue):,} scans", highlight=False)
        for line in not_known(catalogue, condition):
            STDERR.print(f"note: {line}", soft_wrap=True, highlight=False)
    if export is not None and len(found):
        from salpcc.pipeline.find.export_found import export_found

        for path, counts in export_found(found, folder, export):
            STDERR.print(f"{path}: {counts.told}", soft_wrap=True, highlight=False)


def _lines(found: pa.Table, columns: list[str]) -> list[str]:
    """A head and a line a scan, in columns; times in seconds."""
    cells = [[name, *(_cell(name, value) for value in found.column(name).to_pylist())] for name in columns]
    widths = [max(map(len, column)) for column in cells]
    left = {"sequence", "name", "archive", "checksum"}
    return [
        "  ".join(
            cell.ljust(width) if name in left else cell.rjust(width)
            for name, cell, width in zip(columns, row, widths, strict=True)
        ).rstrip()
        for row in zip(*cells, strict=True)
    ]


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "-"
    if name == "time":
        return f"{value // 10**9}.{value % 10**9:09d}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def cut(
    archive: options.Archive,
    out: New,
    frames: options.Frames = None,
    time: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="From A up to B seconds after the first scan; either may be left out."
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="These topics of a log only, of clouds or others; may be repeated."
        ),
    ] = None,
) -> None:
    """Take a part of an archive; coded scans are copied, only a group that is cut into is coded anew."""
    from salpcc.pipeline.edit.cut import Selection
    from salpcc.pipeline.edit.cut import cut as cut_archive

    selection = Selection(parse_frames(frames), _seconds(time), tuple(topic or ()))
    if selection == Selection():
        raise UsageError("cut takes --frames, --time or --topic")
    typer.echo(f"{cut_archive(archive, out, selection).told}: {out}")


def _seconds(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        span = float(first or 0), float(last or "inf")
    except ValueError:
        span = (0.0, 0.0)
    if not colon or not span[0] < span[1]:
        raise UsageError(f"--time {text}: write A:B, seconds after the first scan, such as 10:12.5 or 60:")
    return span


def merge(
    archives: Annotated[
        list[Path], typer.Argument(parser=location, metavar="ARCHIVE…", help="Two archives or more.")
    ],
    out: New,
) -> None:
    """Put archives of one sensor together, ordered by time where they are of one sequence; coded scans are copied."""
    from salpcc.pipeline.edit.merge import merge as merge_archives

    typer.echo(f"{merge_archives(archives, out).told}: {out}")


def mount(
    archives: Annotated[
        Path,
        typer.Argument(parser=location, metavar="ARCHIVE|DIR", help="An archive, or a folder of archives."),
    ],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="An empty folder in which files appear.")],
    layers: options.Layers = "all",
) -> None:
    """Show archives as the files of SemanticKITTI, decoded when they are read, until Ctrl-C or umount."""
    require("files", "mount")
    from salpcc.pipeline.files.mount import mount as mount_archives

    STDERR.print(f"{archives} is {folder} until Ctrl-C or `umount {folder}`", soft_wrap=True)
    mount_archives(archives, folder, cast("Layers", layers))


def view(
    path: Annotated[
        Path,
        typer.Argument(metavar="ARCHIVE|LOG|MAP", help="An archive, a log, or the folder of a map."),
    ],
    frames: options.Frames = None,
    layers: options.Layers = "all",
    against: Annotated[
        Path | None,
        typer.Option(
            parser=location,
            metavar=PLACE,
            help="Colour by error, too, measured from the source: the root of the data, or the log.",
        ),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser, until Ctrl-C.")] = False,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Write it to a file that Rerun opens.")
    ] = None,
) -> None:
    """Look at scans in 3-D along a time line, coloured by height, intensity, class, layer and error, with the path driven."""
    if web and save:
        raise UsageError("--web and --save: choose one")
    require("view", "view")
    from salpcc.pipeline.view import view as view_scans
    from salpcc.pipeline.view import view_in_browser

    chosen = cast("Layers", layers), parse_frames(frames), against
    if web:
        view_in_browser(path, *chosen, partial(STDERR.print, soft_wrap=True, highlight=False))
        return
    scans = view_scans(path, *chosen, save)
    typer.echo(f"{scans} scan{'' if scans == 1 else 's'}" + (f": {save}" if save else ""))
