"""Training: what it writes, that it learns, and that it goes on where it stopped."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from salpcc.schemas.errors import UsageError
from salpcc.stages.predict.paper.st_lstm.checkpoint import load
from salpcc.stages.predict.paper.st_lstm.dataset import Clip, read_clips
from salpcc.stages.predict.paper.st_lstm.network import Shape
from salpcc.stages.predict.paper.st_lstm.train import Recipe, rate_at, train_predictor

SMALL = Shape(width=4, depth=2, handed=1, head=4)
QUICK = Recipe(iterations=6, rounded_iterations=4, steps=2, columns=64, batch=1, validate_every=5)


@pytest.fixture(scope="module")
def clips(toy_root: Path) -> list[Clip]:
    return list(read_clips(toy_root))


def test_clips_are_runs_of_consecutive_scans(clips: list[Clip]) -> None:
    assert [(clip.name, len(clip.frames), len(clip.inputs)) for clip in clips] == [("00", 5, 4), ("01", 2, 1)]
    assert (clips[0].inputs[0].base > 0).mean() > 0.3


def test_training_goes_on_where_it_stopped(clips: list[Clip], tmp_path: Path) -> None:
    whole = train_predictor(clips, tmp_path / "whole", QUICK, SMALL, log=lambda line: None)
    rows = list(csv.DictReader((tmp_path / "whole" / "log.csv").open()))
    assert [row["iteration"] for row in rows] == ["5", "10"] and [row["rounded"] for row in rows] == [
        "0",
        "1",
    ]
    assert load(tmp_path / "whole" / "st_lstm.safetensors")[1] == SMALL

    class Stopped(Exception):
        pass

    def stop(line: str) -> None:
        raise Stopped

    with pytest.raises(Stopped):
        train_predictor(clips, tmp_path / "parts", QUICK, SMALL, log=stop)
    again = train_predictor(clips, tmp_path / "parts", QUICK, SMALL, log=lambda line: None)
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(UsageError, match="another recipe"):
        train_predictor(clips, tmp_path / "parts", Recipe(iterations=7), SMALL)


def test_it_learns(clips: list[Clip], tmp_path: Path) -> None:
    recipe = Recipe(
        iterations=40, rounded_iterations=0, steps=2, columns=64, batch=1, validate_every=20, rate=1e-2
    )
    train_predictor(clips, tmp_path, recipe, SMALL, log=lambda line: None)
    bits = [float(row["validation_bits"]) for row in csv.DictReader((tmp_path / "log.csv").open())]
    assert bits[-1] < bits[0]


def test_the_rate_rises_and_falls() -> None:
    recipe = Recipe(iterations=100, rounded_iterations=10)
    rates = np.array([rate_at(i, recipe) for i in range(110)])
    assert rates.argmax() == 5 and rates[99] < 0.05 * rates.max() and rates[100] == 0.1 * recipe.rate


def test_nothing_to_train_on(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="consecutive"):
        train_predictor([], tmp_path)
