"""``simulate``, ``calibrate``, ``report``: data in, sensor models, and reports again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from salpcc.pipeline.schedule.progress import STDERR
from salpcc.schemas.errors import SensorError, UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import atomic, location, there
from salpcc.schemas.manifest import expand_sequences


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command(epilog="Example:  `salpcc-pipeline simulate --out DIR --sequences 00,01 --scans 16`")(
        simulate
    )
    app.command(
        epilog="Examples:  `salpcc-pipeline calibrate drive.mcap --out os1.json` then "
        "`salpcc-pipeline run log drive.mcap --sensor os1.json`  ·  "
        "`salpcc-pipeline calibrate DIR/2011_09_26_drive_0005_sync --out hdl64e.json`"
    )(calibrate)
    app.command(epilog="Example:  `salpcc-pipeline report out`")(report)


def simulate(
    out: Annotated[
        Path, typer.Option(help="The root of the new data; it gets sequences/NAME/velodyne and so on.")
    ],
    sequences: Annotated[
        str, typer.Option(help="Names, written as in run sequences; a name seeds its street.")
    ] = "00",
    scans: Annotated[int, typer.Option(min=1, help="Scans of each sequence.")] = 16,
) -> None:
    """Simulate labelled drives in SemanticKITTI layout."""
    require("run", "simulate")
    from salpcc.stages.ingest.sources.simulated import Simulated

    for sequence in expand_sequences(sequences):
        if (out / "sequences" / sequence).exists():
            raise UsageError(f"{out / 'sequences' / sequence} exists; choose another --out or delete it")
        STDERR.print(f"simulating sequence {sequence} …", style="dim")
        refs = Simulated().make(out, sequence, scans)
        typer.echo(f"{len(refs)} scans in {out / 'sequences' / sequence}")


def calibrate(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="A folder of .bin or .pcd.bin scans or one above it, a scan, an MCAP file, or a bag.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.json", help="The sensor model is written here.")],
    topic: Annotated[
        str | None, typer.Option(help="Use the point clouds of this topic, where the log has several.")
    ] = None,
    scans: Annotated[int, typer.Option(min=1, help="Use at most so many scans, evenly spread.")] = 40,
) -> None:
    """Find the lasers, steps and lever arms of any spinning LiDAR from its scans alone, and write them as a sensor model."""
    from salpcc.pipeline.sensors.calibration import calibrate_log, summary
    from salpcc.stages.lattice.sensor_model import load_sensor

    if out.suffix != ".json":  # it would take the place of a log
        raise UsageError(f"{out}: a sensor model is a file NAME.json")
    if there(out):
        try:
            load_sensor(out.absolute())
        except SensorError as error:
            raise UsageError(f"{out}: exists, and is no sensor model; name another --out") from error
    if not log.exists():
        raise UsageError(f"{log}: not found; name a folder of scans, a scan, or a log")
    found = calibrate_log(log, scans, out.stem, (topic,) if topic else ())
    with atomic(out) as stream:
        stream.write(found.fit.model.to_json().encode())
    for line in summary(found):
        typer.echo(line)
    typer.echo(f"sensor model: {out}; use it with --sensor {out}")


def report(
    out: Annotated[Path, typer.Argument(parser=location, metavar="OUT", help="The output folder of a run.")],
    beside: Annotated[
        list[Path] | None,
        typer.Option(parser=location, metavar="DIR|URL", help="Show this run or map, too; may be repeated."),
    ] = None,
    paper: Annotated[
        bool,
        typer.Option(
            "--paper", help="Show the paper's published tables, too, and what of them is not measured."
        ),
    ] = False,
) -> None:
    """Rebuild the tables, plots and page of a run from what it measured."""
    require("run", "report")
    from salpcc.stages.evaluate.report.write import build

    for folder in (out, *(beside or [])):
        if not (folder / "report").is_dir():
            raise UsageError(f"{folder}: no report there; name the --out of a run")
    build(out, beside or [], paper)
    typer.echo(f"report: {out / 'report' / 'index.html'}")
