"""The training loop: Adam, one cosine cycle, an average of the weights, checkpoints that resume."""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from salpcc.schemas.errors import UsageError
from salpcc.schemas.work import ScanRef
from salpcc.stages.segment.network.checkpoint import load_weights, save_weights
from salpcc.stages.segment.network.multimodal import WIDTHS, SegmentNetwork, for_cpu
from salpcc.stages.segment.network.point_branch import PointTensors
from salpcc.stages.segment.network.quantised import for_labelling
from salpcc.stages.segment.training.class_weights import IN_STREETS, training_weights, unweigh, weigh
from salpcc.stages.segment.training.labelled import sequence_of
from salpcc.stages.segment.training.losses import rows_of, segmentation_loss, teachers_loss
from salpcc.stages.segment.training.recipe import Phase, Recipe
from salpcc.stages.segment.training.samples import Batch, Samples, loader
from salpcc.stages.segment.training.score import count_scans, scores
from salpcc.stages.segment.weights_file import weights_path

Log = Callable[[str], None]

_FOLLOW = 0.998  # share of the average that stays at each step
_WARM_UP = 0.03  # share of the steps
_TRUSTED = 0.3  # share of the steps after which what teachers say counts in full
TEACHERS = "wide"


class Learner:
    """One network that learns, the average of its weights, its optimiser."""

    def __init__(self, recipe: Recipe, width: str, device: str) -> None:
        self.network = for_cpu(SegmentNetwork(WIDTHS[width])).to(device)
        self.average = for_cpu(SegmentNetwork(WIDTHS[width])).to(device).eval()
        self.average.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), recipe.rate, recipe.betas, weight_decay=recipe.decay
        )

    def follow(self, loss: Tensor, rate: float, step: int) -> None:
        """Take a step down a loss, and let the average follow."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        follow = min(_FOLLOW, step / (step + 20))
        now = self.network.state_dict()
        for name, value in self.average.state_dict().items():
            if value.is_floating_point():
                value.lerp_(now[name].detach(), 1.0 - follow)

    def tensors(self, head: str) -> dict[str, torch.Tensor]:
        """What :meth:`take_back` needs, by names that begin with ``head``."""
        tensors = {f"{head}.network.{k}": v for k, v in self.network.state_dict().items()}
        tensors |= {f"{head}.average.{k}": v for k, v in self.average.state_dict().items()}
        for number, state in self.optimiser.state_dict()["state"].items():
            tensors |= {f"{head}.optimiser.{number}.{k}": torch.as_tensor(v) for k, v in state.items()}
        return tensors

    def take_back(self, head: str, tensors: Mapping[str, torch.Tensor]) -> None:
        """Inverse of :meth:`tensors`."""
        part = lambda of: {k.removeprefix(of): v for k, v in tensors.items() if k.startswith(of)}
        self.network.load_state_dict(part(f"{head}.network."))
        self.average.load_state_dict(part(f"{head}.average."))
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in part(f"{head}.optimiser.").items():
            number, key = name.split(".", 1)
            state.setdefault(int(number), {})[key] = value
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": state, "param_groups": groups})


class Trainer:
    """One training: the network that is asked for, and its teachers.

    Teachers are wider and learn from the same crops, of labels alone; the network learns from labels and from what the averages of its teachers
    say of every pixel, whoever labelled it (knowledge distillation; Hinton et al., 2015). Of fifty scans a small
    network alone learns by heart what two larger ones can agree on.
    """

    def __init__(self, recipe: Recipe, refs: Sequence[ScanRef], device: str = "cpu") -> None:
        torch.manual_seed(recipe.seed)
        self.recipe = recipe
        self.refs = list(refs)
        self.device = device
        self.step = 0
        self.pupil = Learner(recipe, recipe.width, device)
        self.teachers = [Learner(recipe, TEACHERS, device) for _ in range(recipe.teachers)]
        self.begun: dict[str, torch.Tensor] | None = None
        if recipe.start:
            begun, facts = load_weights(weights_path(recipe.start))
            if begun.config != self.pupil.network.config:
                raise UsageError(f"--start {recipe.start}: weights of another width; asked is {recipe.width}")
            counts = facts.get("in_streets", {})
            assert isinstance(counts, dict)
            self.begun = {k: v.to(device) for k, v in unweigh(begun.state_dict(), counts).items()}
            self.pupil.network.load_state_dict(self.begun)
            self.pupil.average.load_state_dict(self.begun)

    def learners(self) -> dict[str, Learner]:
        """Return all that learn, by name, the one that is asked for last."""
        return {f"teacher{k}": teacher for k, teacher in enumerate(self.teachers)} | {"pupil": self.pupil}

    def rate(self) -> float:
        """Learning rate of the coming step: a short warm-up, then a cosine down to 1 %."""
        share = (self.step + 1) / self.recipe.steps
        if share < _WARM_UP:
            return self.recipe.rate * share / _WARM_UP
        turn = math.pi * (share - _WARM_UP) / (1.0 - _WARM_UP)
        return self.recipe.rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(min(turn, math.pi))))

    def take_step(self, batch: Batch) -> float:
        """Take one step and return the loss against the labels."""
        phase, rate = self.recipe.phase(self.step), self.rate()
        features, sets = batch.features.to(self.device), batch.sets.to(self.device)
        targets = batch.targets.to(self.device)
        weights = torch.from_numpy(training_weights(phase.root)).to(self.device)
        said = self._said(features, sets)
        self.step += 1
        for learner in self.learners().values():
            learner.network.dropped = phase.dropped
            learner.network.train()
            with torch.autocast(self.device, torch.bfloat16):
                logits = learner.network(features, sets)
            loss = told = segmentation_loss(logits, targets, weights, phase.movable)
            if learner is self.pupil and said is not None:
                trust = min(1.0, self.step / (_TRUSTED * self.recipe.steps))
                loss = told + trust * teachers_loss(logits, said, features[:, 0] != 0)
            learner.follow(loss, rate, self.step)
        return told.item()

    def _said(self, features: Tensor, sets: PointTensors) -> Tensor | None:
        """Mean probabilities ``(B H W, 19)`` of the teachers, None where there are none."""
        if not self.teachers:
            return None
        with torch.no_grad(), torch.autocast(self.device, torch.bfloat16):
            every = [torch.softmax(rows_of(one.average(features, sets)), 1) for one in self.teachers]
        return torch.stack(every).mean(0)

    def averaged(self) -> SegmentNetwork:
        """Return a network with the averaged weights, whose classes count as in streets.

        Where the training went on from others, the network is between them and what was learned: it keeps what the
        few new scans do not tell (Wortsman et al., CVPR 2022).
        """
        network = SegmentNetwork(self.pupil.network.config)
        state = self.pupil.average.state_dict()
        if self.begun is not None:
            share = self.recipe.learned
            state = {
                k: v.lerp(state[k], share) if v.is_floating_point() else v for k, v in self.begun.items()
            }
        network.load_state_dict(weigh(state, IN_STREETS))
        return network.eval()

    def save(self, path: Path) -> None:
        """Write what :meth:`resume` needs."""
        tensors: dict[str, torch.Tensor] = {}
        for name, learner in self.learners().items():
            tensors |= learner.tensors(name)
        facts = {"step": str(self.step), "recipe": json.dumps(asdict(self.recipe), sort_keys=True)}
        part = path.with_suffix(".part")
        save_file({k: v.detach().clone().contiguous() for k, v in tensors.items()}, str(part), facts)
        part.replace(path)

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            UsageError: it is not there, or of another recipe.
        """
        if not path.is_file():
            raise UsageError(f"--resume: {path} is not there; train without --resume first")
        from safetensors import safe_open

        with safe_open(str(path), "pt") as file:
            facts = file.metadata() or {}
        if facts.get("recipe") != json.dumps(asdict(self.recipe), sort_keys=True):
            raise UsageError(
                f"{path}: a checkpoint of another recipe; use the same options, or another --out"
            )
        tensors = load_file(str(path), self.device)
        for name, learner in self.learners().items():
            learner.take_back(name, tensors)
        self.step = int(facts["step"])


def train_segment(
    refs: Sequence[ScanRef],
    held_out: Sequence[ScanRef],
    out: Path,
    recipe: Recipe,
    device: str = "cpu",
    donors: Sequence[ScanRef] = (),
    resume: bool = False,
    log: Log = print,
) -> Path:
    """Train on labelled scans and return the path of the weights: ``OUT/segment_WIDTH.safetensors``.

    ``donors`` are labelled scans of which only the vehicles and people are used, pasted into the others.

    ``OUT/training.csv`` has the loss and, where scans are held out, their scores; ``OUT/checkpoint.safetensors``
    is what ``resume`` goes on from.

    Raises:
        UsageError: nothing to train on, or nothing to go on from.
    """
    if all(ref.labels is None for ref in refs):
        raise UsageError("no labelled scans are left to train on; hold out fewer, or give more --data")
    out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(recipe, refs, device)
    checkpoint = out / "checkpoint.safetensors"
    if resume:
        trainer.resume(checkpoint)
    weights = out / f"segment_{recipe.width}.safetensors"
    sequences = sorted({sequence_of(ref) for ref in refs})
    log(f"{len(trainer.refs)} scans of {', '.join(sequences)}; {len(held_out)} held out; step {trainer.step}")
    losses: list[float] = []
    begun = time.monotonic()
    phase: Phase | None = None
    while trainer.step < recipe.steps:
        if phase is not recipe.phase(trainer.step):
            phase = recipe.phase(trainer.step)
            # Crops are not replayed after a resume: another seed draws new ones.
            seed = recipe.seed + 1000 * trainer.step
            config = trainer.pupil.network.config
            batches = loader(
                Samples(trainer.refs, config, recipe.batch, seed, phase.samples, donors), recipe.workers
            )
            log(f"phase {recipe.phases.index(phase) + 1} of {len(recipe.phases)} from step {trainer.step}")
        losses.append(trainer.take_step(next(batches)))
        if trainer.step % recipe.every and trainer.step != recipe.steps:
            continue
        row: dict[str, float] = {
            "step": trainer.step,
            "rate": trainer.rate(),
            "loss": sum(losses) / len(losses),
        }
        row["seconds"] = time.monotonic() - begun
        network = trainer.averaged()
        if held_out:
            row |= scores(count_scans(for_labelling(network, device), held_out))
        facts: dict[str, object] = {
            "sequences": sequences,
            "scans": len(refs),
            "recipe": asdict(recipe),
            "in_streets": IN_STREETS,
            **row,
        }
        trainer.save(checkpoint)
        save_weights(weights, network.state_dict(), network.config, facts)
        _append(out / "training.csv", row)
        log("  ".join(f"{k} {v:.4g}" for k, v in row.items()))
        losses = []
    return weights


def _append(path: Path, row: dict[str, float]) -> None:
    new = not path.exists()
    with path.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)
