"""``salpcc-pipeline train``: the networks, from recorded scans. One command a network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from salpcc.pipeline.schedule.progress import STDERR
from salpcc.schemas.config import Effort
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.manifest import expand_sequences

app = typer.Typer(help="Train a network on recorded scans.", no_args_is_help=True)

Data = Annotated[Path, typer.Option(help="Recorded scans lie here, in any layout that run sequences reads.")]
Out = Annotated[Path, typer.Option(help="The weights go here.")]


@app.command(epilog="Example:  `salpcc-pipeline train coder --data DIR --out weights`")
def coder(
    data: Data,
    out: Out = Path("weights"),
    effort: Annotated[
        Effort, typer.Option(help="The weights are for this effort; those of fast are tables.")
    ] = "default",
    sensor: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="The sensor's model: a shipped one, or a JSON file.")
    ] = "hdl64e",
) -> None:
    """Train the coder's networks (range and intensity), or count its tables."""
    if effort != "fast":
        require("segment", "train coder")
    from salpcc.stages.lattice.sensor_model import load_sensor
    from salpcc.stages.predict.learned.train import read_sweeps, train_coder
    from salpcc.stages.predict.static.train import train_tables

    check_data(data)
    model = load_sensor(sensor)
    sweeps = read_sweeps(data, model)
    if effort == "fast":
        paths = [train_tables((sweep for sweep, _ in sweeps), model, out, STDERR.print)]
    else:
        paths = list(train_coder(sweeps, model, out, effort, log=STDERR.print))
    for path in paths:
        typer.echo(f"weights: {path}")


@app.command(
    epilog="Examples:  `salpcc-pipeline train segment --data DIR`  ·  `… --score small` (score what ships)"
)
def segment(
    data: Annotated[
        list[Path],
        typer.Option(
            help="Labelled scans lie here, in the layout of SemanticKITTI, KITTI's objects or its tracking; may be "
            "repeated."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Weights, checkpoint and training.csv go here.")] = Path(
        "weights"
    ),
    width: Annotated[
        str, typer.Option(metavar="small|wide|paper", help="The width of the network.")
    ] = "small",
    hold_out: Annotated[
        str,
        typer.Option(
            metavar="SEQ[/SCAN],…", help="Score on these sequences or scans, and never train on them."
        ),
    ] = "06",
    donors: Annotated[
        str,
        typer.Option(
            metavar="ROOT",
            help="Paste in vehicles and people of the labelled data that lie here, of simulated streets, or none.",
        ),
    ] = "simulated",
    teachers: Annotated[
        int,
        typer.Option(
            min=0,
            help="So many wide networks learn beside it and tell it what they see, labelled or not. Meant for a GPU: on "
            "a CPU two take seven times as long as the network itself.",
        ),
    ] = 2,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the optimiser.")] = 2000,
    batch: Annotated[int, typer.Option(min=1, help="Crops in a step.")] = 16,
    rate: Annotated[float, typer.Option(help="The learning rate at its peak.")] = 2.5e-3,
    start: Annotated[
        str,
        typer.Option(
            metavar="WEIGHTS",
            help="Go on from these weights, in phases of its own, and end between them and what is learned.",
        ),
    ] = "",
    learned: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="With --start, end this share of the way to what is learned."),
    ] = 0.5,
    teacher: Annotated[
        str,
        typer.Option(
            metavar="WEIGHTS",
            help="Train, too, on what these weights are sure of where --data has no labels, or boxes only.",
        ),
    ] = "",
    any_sensor: Annotated[
        bool,
        typer.Option(
            "--any-sensor", help="Train on crops as other sensors would have seen them, too, half of them."
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="The seed of weights and crops.")] = 0,
    every: Annotated[int, typer.Option(min=1, help="Steps between checkpoints and scores.")] = 250,
    workers: Annotated[int, typer.Option(min=0, help="Processes that make crops.")] = 1,
    device: Annotated[str, typer.Option(metavar="cpu|cuda", help="Train here.")] = "cpu",
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint in --out.")] = False,
    score: Annotated[
        str | None,
        typer.Option(metavar="WEIGHTS", help="Score these weights on --hold-out, and train nothing."),
    ] = None,
) -> None:
    """Train the segmentation network on labelled scans, or score it.

    The defaults are the recipe of the shipped weights: three phases, two teachers, simulated vehicles pasted in.
    """
    require("segment", "train segment")
    from salpcc.stages.segment.network.checkpoint import load_cached
    from salpcc.stages.segment.network.multimodal import WIDTHS
    from salpcc.stages.segment.training.donors import simulated_donors
    from salpcc.stages.segment.training.labelled import list_labelled, split_labelled
    from salpcc.stages.segment.training.loop import train_segment
    from salpcc.stages.segment.training.pseudo_labels import complete_labels
    from salpcc.stages.segment.training.recipe import (
        GOING_ON,
        PHASES,
        Phase,
        Recipe,
        for_any_sensor,
        with_teachers,
    )
    from salpcc.stages.segment.training.score import score_table
    from salpcc.stages.segment.weights_file import weights_path

    for root in data:
        check_data(root)
    if width not in WIDTHS:
        raise UsageError(f"--width {width}: choose from {', '.join(WIDTHS)}")
    check_device(device)
    items = [item.strip() for item in hold_out.split(",") if item.strip()]
    names = [name for item in items for name in ([item] if "/" in item else expand_sequences(item))]
    refs, held_out = split_labelled(data, names, taught=bool(teacher or teachers))
    if score is not None:
        for line in score_table(load_cached(weights_path(score), device), held_out):
            typer.echo(line)
        return
    phases: tuple[Phase, ...] = GOING_ON if start else PHASES
    phases = for_any_sensor(phases) if any_sensor else phases
    phases = with_teachers(phases) if teachers else phases
    recipe = Recipe(
        width,
        teachers,
        steps,
        batch,
        rate,
        seed=seed,
        workers=workers,
        every=every,
        phases=phases,
        start=start,
        learned=learned,
    )
    if donors == "simulated":
        given = simulated_donors(out / "donors", STDERR.print)
    else:
        given = [] if donors == "none" else list_labelled(Path(donors))
    if teacher:
        refs = complete_labels(load_cached(weights_path(teacher), device), refs, out / "taught", STDERR.print)
    path = train_segment(refs, held_out, out, recipe, device, given, resume, log=STDERR.print)
    typer.echo(f"weights: {path}; use them with --weights {path}")


@app.command(
    epilog="Example:  `salpcc-pipeline train predict --data kitti/dataset --data kitti_raw --out weights`"
)
def predict(
    data: Annotated[list[Path], typer.Option(help="Recorded or simulated scans lie here; may be repeated.")],
    out: Out = Path("weights"),
    iterations: Annotated[int, typer.Option(min=1, help="Steps of the optimiser in float.")] = 1000,
    rounded: Annotated[
        int, typer.Option(min=0, help="Steps after those, with the rounding of whole numbers.")
    ] = 120,
    batch: Annotated[int, typer.Option(min=1, help="Windows in a step.")] = 2,
    rate: Annotated[float, typer.Option(help="The learning rate at its peak.")] = 2e-3,
    seed: Annotated[int, typer.Option(help="The seed of weights and windows.")] = 0,
    device: Annotated[str, typer.Option(metavar="cpu|cuda", help="Train here.")] = "cpu",
) -> None:
    """Train the prediction network of the paper profile on consecutive scans; sequence 06 validates.

    Goes on from where --out stopped.
    """
    require("paper", "train predict")
    from salpcc.stages.predict.paper.st_lstm.dataset import read_clips
    from salpcc.stages.predict.paper.st_lstm.train import Recipe, train_predictor

    check_device(device)
    for root in data:
        check_data(root)
    recipe = Recipe(iterations, rounded, batch=batch, rate=rate, seed=seed)
    clips = [clip for root in data for clip in read_clips(root)]
    train_predictor(clips, out, recipe, device=device, log=STDERR.print)
    typer.echo(f"weights: {out / 'st_lstm.safetensors'}")


def check_device(device: str) -> None:
    """Refuse a device that is not here."""
    import torch

    if device not in ("cpu", "cuda"):
        raise UsageError(f"--device {device}: choose from cpu, cuda")
    if device == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device cuda: torch sees no GPU here; use --device cpu")


def check_data(data: Path) -> None:
    """Refuse a root that is not there."""
    if not data.is_dir():
        raise UsageError(f"--data {data}: not found; a root of recorded scans is wanted")
