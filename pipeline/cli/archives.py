"""``decode``, ``verify``, ``redact``, ``recover``, ``inspect``: what one does with archives."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Console

from salpcc.pipeline.cli import options
from salpcc.pipeline.cli.described import show_archive, show_shard
from salpcc.pipeline.cli.options import BOX, PLACE, parse_box, parse_frames
from salpcc.pipeline.cli.summary import layers_in_words
from salpcc.pipeline.schedule.machine import cores
from salpcc.pipeline.schedule.progress import STDERR
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import location

if TYPE_CHECKING:
    from salpcc.pipeline.decode import Layers
    from salpcc.pipeline.export import Export
    from salpcc.stages.lattice.frame import Frame

Threads = Annotated[
    int | None,
    typer.Option(min=1, metavar="N", help="Groups of scans to decode at once. [default: one per core]"),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command(epilog="Example:  `salpcc-pipeline decode out/archives/04.mcap --to kitti --out back`")(
        decode
    )
    app.command(epilog="Example:  `salpcc-pipeline verify out/archives/04.mcap --against DIR`")(verify)
    app.command(
        epilog="Example:  `salpcc-pipeline redact out/archives/04.mcap --out public/04.mcap`, then "
        "`salpcc-pipeline verify public/04.mcap --redacted-from public/04.json`"
    )(redact)
    app.command(epilog="Example:  `salpcc-pipeline recover damaged.mcap --out whole.mcap`")(recover)
    app.command(epilog="Example:  `salpcc-pipeline inspect out/archives/04.mcap`")(inspect)


def decode(
    archive: options.Archive,
    to: Annotated[str, typer.Option(metavar="FORMAT", help="What to write: kitti, mcap, bag, ply or laz.")],
    out: Annotated[Path, typer.Option(parser=location, metavar=PLACE, help="The files are written here.")],
    frames: options.Frames = None,
    crs: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The coordinate system to state in LAZ, such as EPSG:25832."),
    ] = None,
    layers: options.Layers = "all",
    frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="Which frame: recorded; sensor, the motion compensation undone; start or end of the turn.",
        ),
    ] = "recorded",
    threads: Threads = None,
) -> None:
    """Turn an archive back into scans, bit for bit where it was made so."""
    from salpcc.pipeline.archive import Archive
    from salpcc.pipeline.export import EXPORTS
    from salpcc.pipeline.export.laz import to_laz

    if to not in EXPORTS:
        raise UsageError(f"--to {to}: choose from {', '.join(EXPORTS)}")
    if crs and to != "laz":
        raise UsageError(f"--crs: --to {to} has no place for it; --to laz has")
    export: Export = partial(to_laz, crs=crs) if crs else EXPORTS[to]
    asked = cast("Layers", layers), cast("Frame", frame)
    with Archive.open(archive, threads or cores(), *asked) as opened:
        count = 0
        gone = opened.bare(parse_frames(frames))
        scans = opened.of_frames(parse_frames(frames), without=gone)
        for path in export(opened, scans, out, partial(STDERR.print, soft_wrap=True)):
            count += 1
            folder = path.parent
        if not count:
            raise UsageError(f"{archive}: it holds no scan; --to mcap gives its other messages")
        typer.echo(f"{count} file{'s' if count > 1 else ''} in {folder}")
    for name in gone:
        STDERR.print(
            f"failed: scan {name}: its movable layer is gone; --layers static gives what is left",
            soft_wrap=True,
        )
    raise typer.Exit(1 if gone else 0)


def verify(
    archive: options.Archive,
    against: Annotated[
        Path | None,
        typer.Option(
            parser=location,
            metavar=PLACE,
            help="Compare every point with its source: the root of the data, or the log.",
        ),
    ] = None,
    redacted_from: Annotated[
        Path | None,
        typer.Option(
            parser=location,
            metavar="FILE.json",
            help="Check that the archive is what the redaction of this manifest left.",
        ),
    ] = None,
    json_: options.Json = False,
    threads: Threads = None,
) -> None:
    """Check every checksum and decode everything; with --against, compare with the source."""
    from salpcc.pipeline.verify import verify as verify_archive

    verdict = verify_archive(archive, against, threads or cores(), redacted_from)
    if json_:
        typer.echo(json.dumps(verdict.as_dict(), indent=1))
    else:
        for problem in verdict.problems:
            typer.echo(f"PROBLEM {problem}")
        held = "; every checksum holds" if verdict.good else ""
        hint = " (--against compares with the source)" if verdict.good and not against else ""
        typer.echo(
            f"{'ok' if verdict.good else 'DAMAGED'}: {archive}: {verdict.scans:,} scans, "
            f"{verdict.points:,} points{held}{hint}"
        )
        if against is not None:
            typer.echo(_compared(verdict.as_dict()))
        if redacted_from is not None and verdict.good:
            typer.echo(f"its chunks are byte for byte those that {redacted_from} tells of")
        if verdict.labelled_scans or verdict.side_files:
            typer.echo(f"labels of {verdict.labelled_scans} scans, {verdict.side_files} side files")
        if verdict.movable:
            typer.echo(layers_in_words(verdict.movable, verdict.layers))
    raise typer.Exit(0 if verdict.good else 1)


def _compared(verdict: dict[str, Any]) -> str:
    error, passed = verdict["max_error_m"], verdict["passed_messages"]
    elsewhere = verdict["scans_elsewhere"]
    which = f"{elsewhere[0]} to {elsewhere[-1]}" if len(elsewhere) > 1 else "".join(elsewhere)
    return (
        f"against {verdict['against']}: {verdict['bit_exact_scans']:,} scans bit-exact, "
        f"{verdict['points_dropped']:,} points dropped"
        + (f", largest error {1e3 * error:.2f} mm" if error else "")
        + (f", {passed:,} messages of other topics unchanged" if passed is not None else "")
        + (f"; not in the archive: {len(elsewhere):,} of its scans, {which}" if elsewhere else "")
    )


def redact(
    archive: options.Archive,
    out: Annotated[
        Path,
        typer.Option(
            parser=location, metavar="FILE|URL", help="The new archive; its manifest lies beside it, .json."
        ),
    ],
    frames: options.Frames = None,
    classes: Annotated[
        str | None, typer.Option(metavar="NAME,NAME", help="Of these classes only, where they are stored.")
    ] = None,
    box: Annotated[
        str | None,
        typer.Option(metavar=BOX, help="Within this box only, metres in the frame of the poses."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            parser=location, metavar="FILE", help="KITTI poses for --box. [default: those in the archive]"
        ),
    ] = None,
) -> None:
    """Take out what may move; the static layer stays byte for byte, which the manifest proves."""
    from salpcc.pipeline.edit.redact import Selection, describe, manifest_path
    from salpcc.pipeline.edit.redact import redact as redact_archive
    from salpcc.stages.residual_code.archive.reader import ArchiveReader

    chosen = Selection(
        parse_frames(frames),
        tuple(classes.split(",")) if classes else (),
        parse_box("--box", box) if box else (),
    )
    manifest = redact_archive(archive, out, chosen, poses)
    typer.echo(f"{describe(manifest, ArchiveReader(out))}\narchive: {out}\nmanifest: {manifest_path(out)}")


def recover(
    archive: options.Archive,
    out: Annotated[
        Path,
        typer.Option(parser=location, metavar="FILE|URL", help="The new archive; nothing is overwritten."),
    ],
    sensor: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="The sensor's model, where the one in the archive is gone."),
    ] = None,
    json_: options.Json = False,
) -> None:
    """Save every scan that is whole from a truncated or damaged archive, and name the others."""
    from salpcc.pipeline.edit.recover import recover as recover_archive
    from salpcc.stages.lattice.sensor_model import load_sensor

    found = recover_archive(archive, out, load_sensor(sensor) if sensor else None)
    if json_:
        typer.echo(json.dumps(found.as_dict(), indent=1))
    else:
        for name in found.gone:
            typer.echo(f"GONE scan {name}")
        for note in found.notes:
            typer.echo(f"NOTE {note}")
        state = "nothing is gone" if found.complete else f"{len(found.gone)} scans known to be gone"
        typer.echo(f"{found.scans} scans recovered, {state}: {out}")
    raise typer.Exit(0 if found.complete else 1)


def inspect(
    path: Annotated[
        Path,
        typer.Argument(
            parser=location, metavar="ARCHIVE|SHARD", help="An archive (.mcap) or a shard (.arrow)."
        ),
    ],
    scans: Annotated[bool, typer.Option("--scans", help="Show a row for every scan.")] = False,
    json_: options.Json = False,
) -> None:
    """Show what is in an archive or a shard, without decoding it."""
    from salpcc.pipeline.inspect import inspect as describe

    found = describe(path)
    if json_:
        typer.echo(json.dumps(found, indent=1, default=str))
        return
    if found["kind"] == "shard":
        show_shard(found, Console(emoji=False, markup=False))
    else:
        show_archive(found, Console(emoji=False, markup=False), scans)
