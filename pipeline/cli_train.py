"""``salpcc-pipeline train``: the networks, from recorded scans. One command a network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from salpcc.pipeline.progress import STDERR
from salpcc.schemas.config import Effort
from salpcc.schemas.errors import UsageError

app = typer.Typer(help="Train a network on recorded scans.", no_args_is_help=True)

Data = Annotated[Path, typer.Option(help="Root of recorded scans, in any layout that run sequences reads")]
Out = Annotated[Path, typer.Option(help="Folder for the weights")]


@app.command(epilog="Example:  `salpcc-pipeline train coder --data DIR --out weights`")
def coder(
    data: Data,
    out: Out = Path("weights"),
    effort: Annotated[
        Effort, typer.Option(help="Which effort the weights are for; fast has none")
    ] = "default",
    sensor: Annotated[str, typer.Option(help="Shipped sensor model, or a JSON file")] = "hdl64e",
) -> None:
    """Train the coder's networks (range and intensity)."""
    from salpcc.stages.ingest.sensor_model import load_sensor
    from salpcc.stages.predict.learned.train import RECIPES, read_sweeps, train_coder

    if effort not in RECIPES:
        raise UsageError(f"--effort {effort}: choose from {', '.join(RECIPES)}")
    check_data(data)
    model = load_sensor(sensor)
    for path in train_coder(read_sweeps(data, model), model, out, effort, log=STDERR.print):
        typer.echo(f"weights: {path}")


def check_data(data: Path) -> None:
    """Refuse a root that is not there."""
    if not data.is_dir():
        raise UsageError(f"--data {data}: not found; a root of recorded scans is wanted")
