"""Train the prediction network: the paper's loss (20) and the code length of the residual; CPU or GPU."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from salpcc.schemas.errors import UsageError
from salpcc.stages.predict.paper.st_lstm.arithmetic import ONE, Trainable
from salpcc.stages.predict.paper.st_lstm.batches import Window, draw, whole
from salpcc.stages.predict.paper.st_lstm.checkpoint import export, save
from salpcc.stages.predict.paper.st_lstm.dataset import Clip
from salpcc.stages.predict.paper.st_lstm.inputs import FARTHEST, NEIGHBOURS
from salpcc.stages.predict.paper.st_lstm.network import Shape, first_state, mixed_ranges, step

Log = Callable[[str], None]
VALIDATION = "06"  # as in the paper
_ERROR_OFFSET, _ERROR_FEATURE = len(NEIGHBOURS) + 2, 9
_COLUMNS_OF_LOG = ("iteration", "rounded", "rate", "loss", "validation_bits", "validation_l1_mm")


@dataclass(frozen=True)
class Recipe:
    """How the network is trained.

    Attributes:
        iterations: in float; ``rounded_iterations`` after them with the integers' rounding.
        steps, columns, batch: of each window.
        rate: highest learning rate of the one-cycle schedule; the rounded part starts at a tenth.
        norms: weight of the paper's loss (20), in metres, beside the code length.
        validate_every: iterations.
    """

    iterations: int = 1000
    rounded_iterations: int = 120
    steps: int = 5
    columns: int = 400
    batch: int = 2
    rate: float = 2e-3
    norms: float = 0.05
    validate_every: int = 100
    seed: int = 0


def rollout(numbers: Trainable, shape: Shape, window: Window) -> tuple[list[Tensor], list[Tensor]]:
    """Run the network over a window; returns predicted ranges (mm) and log2 spreads of each step."""
    state = first_state(shape, window.features[:, 0].float())
    predicted: list[Tensor] = []
    spreads: list[Tensor] = []
    for number in range(window.base.shape[1]):
        features, offsets = window.features[:, number].float(), window.offsets[:, number].float()
        if predicted:
            seen = (window.last[:, number] > 0) & (predicted[-1] > 0) & (window.base[:, number] > 0)
            error = torch.where(seen, window.last[:, number] - predicted[-1].detach().round(), 0.0)
            error = error.clamp(-FARTHEST, FARTHEST)
            offsets[:, _ERROR_OFFSET] = error
            features[:, _ERROR_FEATURE] = error.sign() * (32.0 * error.abs()).sqrt().floor()
        shares, spread, state = step(numbers, shape, features / ONE, state)
        predicted.append(mixed_ranges(window.base[:, number].float(), offsets, shares))
        spreads.append(spread)
    return predicted, spreads


def code_length(error: Tensor, spread: Tensor) -> Tensor:
    """Return bits of a residual of whole millimetres: Laplace of scale ``2**spread``, 5 % of it 32 times as wide."""
    scale = torch.exp2(spread.clamp(0.5, 13.0))
    narrow = -error / scale - torch.log(2.0 * scale) + np.log(0.95)
    wide = -error / (32.0 * scale) - torch.log(64.0 * scale) + np.log(0.05)
    return -torch.logaddexp(narrow, wide) / np.log(2.0)


def loss_of(
    predicted: Sequence[Tensor], spreads: Sequence[Tensor], window: Window, norms: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the loss, bits and L1 (mm) over the cells that are filled and have a prediction."""
    p, s = torch.stack(list(predicted), 1), torch.stack(list(spreads), 1)
    valid = (window.target > 0) & (window.base > 0)
    error = (p - window.target).abs()[valid]
    bits = code_length(error, s[valid]).mean()
    metres = error / 1000.0
    paper = metres.mean() + (metres.square().mean() + 1e-12).sqrt()  # (20)
    return bits + norms * paper, bits.detach(), error.detach().mean()


def validate(numbers: Trainable, shape: Shape, clips: Sequence[Clip]) -> tuple[float, float]:
    """Return bits a point and L1 (mm) over whole clips, each from its first frame."""
    bits, far = [], []
    device = next(numbers.parameters()).device
    with torch.no_grad():
        for clip in clips:
            window = to(whole(clip), device)
            _, b, e = loss_of(*rollout(numbers, shape, window), window, 0.0)
            bits.append(float(b))
            far.append(float(e))
    return float(np.mean(bits)), float(np.mean(far))


def to(window: Window, device: torch.device | str) -> Window:
    """Move a window to a device."""
    return Window(**{name: value.to(device) for name, value in vars(window).items()})


def train_predictor(
    clips: Sequence[Clip],
    folder: Path,
    recipe: Recipe | None = None,
    shape: Shape | None = None,
    device: str = "cpu",
    log: Log = print,
) -> Trainable:
    """Train on all clips but those of :data:`VALIDATION`; goes on where ``folder/state.pt`` stopped.

    Writes ``st_lstm.safetensors`` (whole numbers, for :func:`~.checkpoint.load`), ``log.csv`` and
    ``state.pt`` to ``folder``.

    Raises:
        UsageError: no clip to train on, or the folder holds the state of another recipe.
    """
    recipe, shape = recipe or Recipe(), shape or Shape()
    learn = [clip for clip in clips if clip.name != VALIDATION]
    check = [clip for clip in clips if clip.name == VALIDATION] or learn[:1]
    if not learn:
        raise UsageError("no two consecutive scans to train on; name the root of some with --data")
    torch.manual_seed(recipe.seed)
    numbers = Trainable(shape.layers()).to(device)
    optimiser = torch.optim.AdamW(numbers.parameters(), recipe.rate, betas=(0.9, 0.99), weight_decay=1e-4)
    folder.mkdir(parents=True, exist_ok=True)
    made_by = {"recipe": asdict(recipe), "shape": asdict(shape)}
    start = _resume(folder / "state.pt", made_by, numbers, optimiser)
    total = recipe.iterations + recipe.rounded_iterations
    losses: list[float] = []
    with (folder / "log.csv").open("a" if start else "w", newline="") as stream:
        rows = csv.writer(stream)
        if not start:
            rows.writerow(_COLUMNS_OF_LOG)
        for iteration in range(start, total):
            if iteration == recipe.iterations:
                numbers.settle()
            rate = rate_at(iteration, recipe)
            # Seeded by the iteration, so that a resumed training sees the same windows.
            rng = np.random.default_rng((recipe.seed, iteration))
            window = to(draw(learn, rng, recipe.steps, recipe.columns, recipe.batch), device)
            losses.append(_improve(numbers, shape, window, optimiser, rate, recipe.norms))
            if (iteration + 1) % recipe.validate_every and iteration + 1 < total:
                continue
            bits, far = validate(numbers, shape, check)
            mean = float(np.mean(losses[-recipe.validate_every :]))
            row = (
                iteration + 1,
                int(numbers.rounded),
                f"{rate:.2e}",
                f"{mean:.4f}",
                f"{bits:.4f}",
                f"{far:.2f}",
            )
            rows.writerow(row)
            stream.flush()
            _keep(folder / "state.pt", made_by, numbers, optimiser, iteration + 1)
            log(f"{iteration + 1}/{total}: loss {mean:.3f}, validation {bits:.3f} bits, L1 {far:.0f} mm")
    if not numbers.rounded:
        numbers.settle()
    save(folder / "st_lstm.safetensors", export(numbers), shape)
    return numbers


def _improve(
    numbers: Trainable,
    shape: Shape,
    window: Window,
    optimiser: torch.optim.Optimizer,
    rate: float,
    norms: float,
) -> float:
    """Take one optimiser step; returns the loss."""
    for group in optimiser.param_groups:
        group["lr"] = rate
    loss, _, _ = loss_of(*rollout(numbers, shape, window), window, norms)
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(numbers.parameters(), 1.0)
    optimiser.step()
    return float(loss.detach())


def _keep(
    path: Path, made_by: dict[str, Any], numbers: Trainable, optimiser: torch.optim.Optimizer, iteration: int
) -> None:
    state = {
        "numbers": numbers.state_dict(),
        "optimiser": optimiser.state_dict(),
        "iteration": iteration,
        "rounded": numbers.rounded,
        "bits": numbers.bits,
    }
    part = path.with_suffix(".part")
    torch.save(made_by | state, part)
    part.replace(path)


def _resume(path: Path, made_by: dict[str, Any], numbers: Trainable, optimiser: torch.optim.Optimizer) -> int:
    """Take up what :func:`_keep` wrote, if anything; returns the iterations done."""
    if not path.is_file():
        return 0
    found = torch.load(path, map_location=next(numbers.parameters()).device, weights_only=True)
    if any(found[name] != value for name, value in made_by.items()):
        raise UsageError(f"{path}: another recipe was trained there; choose another --out or delete it")
    numbers.load_state_dict(found["numbers"])
    optimiser.load_state_dict(found["optimiser"])
    numbers.rounded, numbers.bits = bool(found["rounded"]), found["bits"]
    return int(found["iteration"])


def rate_at(iteration: int, recipe: Recipe) -> float:
    """One cycle: up over the first 5 %, down along a cosine; then a tenth, down again while rounded."""
    if iteration >= recipe.iterations:
        return 0.1 * recipe.rate * (1.0 - (iteration - recipe.iterations) / max(recipe.rounded_iterations, 1))
    part = iteration / max(recipe.iterations, 1)
    if part < 0.05:
        return recipe.rate * (0.1 + 0.9 * part / 0.05)
    return recipe.rate * (0.02 + 0.98 * 0.5 * (1.0 + float(np.cos(np.pi * (part - 0.05) / 0.95))))
