"""A training in small: the loss falls, a checkpoint goes on where it was, the weights that come out label."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from salpcc.pipeline.cli.train_networks import app
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.labels import CLASSES
from salpcc.stages.segment.network import multimodal as network
from salpcc.stages.segment.network.checkpoint import load_weights
from salpcc.stages.segment.network.fused import FusedNetwork
from salpcc.stages.segment.network.multimodal import NetworkConfig
from salpcc.stages.segment.network.range_image import RANGE
from salpcc.stages.segment.segmenter import label_points
from salpcc.stages.segment.training import loop
from salpcc.stages.segment.training.class_weights import IN_STREETS, training_weights, unweigh, weigh
from salpcc.stages.segment.training.donors import simulated_donors
from salpcc.stages.segment.training.labelled import NOT_MOVABLE, LabelledScans, list_labelled, split_labelled
from salpcc.stages.segment.training.loop import Trainer, train_segment
from salpcc.stages.segment.training.losses import rows_of
from salpcc.stages.segment.training.recipe import PHASES, Phase, Recipe, SampleConfig
from salpcc.stages.segment.training.samples import Batch, InstanceBank, Samples

TINY = NetworkConfig("tiny", 4, 8, 4, 1, (8, 8, 8), 1024, 16, (16, 16), 1)
SAMPLES = SampleConfig(width=128)
PLAIN = (Phase(samples=SAMPLES),)
RECIPE = Recipe("tiny", steps=24, batch=2, rate=5e-3, workers=0, every=12, phases=PLAIN)


@pytest.fixture(autouse=True)
def tiny_width(monkeypatch) -> None:
    monkeypatch.setitem(network.WIDTHS, "tiny", TINY)


@pytest.fixture(scope="module")
def street(tmp_path_factory, sensor) -> Path:
    from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence

    root = tmp_path_factory.mktemp("street")
    simulate_sequence(SimulationConfig("00", scans=1, seed=1, scene="suburb"), root, sensor)
    simulate_sequence(SimulationConfig("01", scans=1, seed=2, scene="suburb"), root, sensor)
    return root


def test_training_learns_and_leaves_weights(street: Path, tmp_path: Path) -> None:
    refs, held_out = split_labelled([street], ["01"])
    lines: list[str] = []
    path = train_segment(refs, held_out, tmp_path, RECIPE, donors=held_out, log=lines.append)
    log = (tmp_path / "training.csv").read_text().splitlines()
    assert len(log) == 3 and log[0].startswith("step,rate,loss") and len(lines) == 4
    first, last = (float(row.split(",")[2]) for row in log[1:])
    assert last < 0.95 * first
    trained, facts = load_weights(path)
    assert facts["sequences"] == ["00"] and facts["step"] == 24 and 0 <= facts["ground"] <= 1
    points = np.random.default_rng(0).normal(0, 10, (200, 3)).astype(np.float32)
    assert len(label_points(FusedNetwork(trained), points, np.zeros(200, np.float32))) == 200


def test_a_checkpoint_goes_on(street: Path, tmp_path: Path) -> None:
    refs = list_labelled(street)
    batch = Samples(refs, TINY, 2, 0, SAMPLES).draw(np.random.default_rng(0))
    straight = Trainer(RECIPE, refs)
    for _ in range(3):
        straight.take_step(batch)
    straight.save(tmp_path / "checkpoint.safetensors")
    resumed = Trainer(RECIPE, refs)
    resumed.resume(tmp_path / "checkpoint.safetensors")
    assert resumed.step == 3
    losses = []
    for one in (straight, resumed):
        torch.manual_seed(1)  # of the dropout
        losses.append(one.take_step(batch))
    assert abs(losses[0] - losses[1]) < 1e-5
    for name, value in straight.pupil.average.state_dict().items():
        assert torch.allclose(value.float(), resumed.pupil.average.state_dict()[name].float(), atol=1e-5), (
            name
        )
    with pytest.raises(UsageError, match="another recipe"):
        Trainer(replace(RECIPE, seed=9), refs).resume(tmp_path / "checkpoint.safetensors")
    with pytest.raises(UsageError, match="not there"):
        resumed.resume(tmp_path / "nothing.safetensors")


def test_crops_follow_the_seed(street: Path) -> None:
    samples = [Samples(list_labelled(street), TINY, 2, 7, SAMPLES) for _ in range(2)]
    first, second = (next(iter(one)) for one in samples)
    assert torch.equal(first.features, second.features) and torch.equal(first.targets, second.targets)
    assert first.targets.min() >= -1 and first.targets.max() < NOT_MOVABLE


def test_scans_are_read_as_they_are_needed(street: Path, toy_root: Path) -> None:
    scans = LabelledScans(list_labelled(street), memory=1)
    assert scans[0] is scans[0] and scans[1] is scans[1] and scans[0] is not scans[1]
    assert (scans[0].instances > 0).any() and not scans[0].instances[scans[0].classes == 9].any()
    with pytest.raises(SourceError, match="no labelled scans of 09/000007"):
        split_labelled([street], ["01", "09/000007"])
    rest, held_out = split_labelled([street], ["00", "01/000000"])
    assert len(held_out) == 2
    with pytest.raises(UsageError, match="no labelled scans are left"):
        train_segment(rest, held_out, toy_root, RECIPE)


def test_one_command_walks_through_the_phases_and_goes_on_where_it_stopped(
    street: Path, tmp_path: Path, monkeypatch
) -> None:
    words = f"segment --data {street} --hold-out 01 --out {tmp_path} --width tiny --donors {street}"
    command = f"{words} --steps 8 --batch 1 --every 2 --workers 0 --teachers 0".split()
    save = Trainer.save

    def save_and_stop(trainer: Trainer, path: Path) -> None:
        save(trainer, path)
        if trainer.step == 4:
            raise KeyboardInterrupt

    taken: list[tuple[int, float]] = []
    step = Trainer.take_step

    def noted(trainer: Trainer, batch: Batch) -> float:
        loss = step(trainer, batch)
        taken.append((trainer.step, trainer.pupil.network.dropped))
        return loss

    monkeypatch.setattr(Trainer, "take_step", noted)
    with monkeypatch.context() as stopped:
        stopped.setattr(Trainer, "save", save_and_stop)
        assert CliRunner().invoke(app, command).exit_code == 130
    done = CliRunner().invoke(app, [*command, "--resume"])
    assert done.exit_code == 0, done.output
    assert "phase 2 of 3 from step 4" in done.output and "phase 3 of 3 from step 5" in done.output
    assert taken == [(n, 0.0 if n <= 5 else 0.1) for n in range(1, 9)]
    rows = (tmp_path / "training.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", "2", "6", "8"]
    assert load_weights(tmp_path / "segment_tiny.safetensors")[1]["recipe"]["steps"] == 8


def test_phases_differ_in_what_is_pasted_and_weighed(street: Path) -> None:
    recipe = Recipe(steps=100)
    assert [recipe.phase(n) for n in (0, 34, 35, 59, 60, 99, 100)] == [
        PHASES[i] for i in (0, 0, 1, 1, 2, 2, 2)
    ]
    rare = 7  # motorcyclist
    heavy, plain = (training_weights(phase.root)[rare] for phase in PHASES[:2])
    assert heavy > 1.2 * plain
    bank = InstanceBank()
    rng = np.random.default_rng(0)
    for image in (LabelledScans(list_labelled(street))[i] for i in range(2)):
        bank.add(image, rng)
    cars = [
        np.mean([bank.draw(rng, phase.samples.kinds).label == 1 for _ in range(400)])
        for phase in (PHASES[0], PHASES[2])
    ]
    assert cars[1] > cars[0] + 0.1


def test_donors_are_simulated_once(tmp_path: Path) -> None:
    said: list[str] = []
    first = simulated_donors(tmp_path / "donors", said.append, range(30, 31))
    again = simulated_donors(tmp_path / "donors", said.append, range(30, 31))
    assert [ref.path for ref in first] == [ref.path for ref in again] and len(first) == 2 and len(said) == 1


@pytest.mark.parametrize("share", [0.5, 0.25])
def test_going_on_ends_between_what_was_and_what_is_learned(
    street: Path, tmp_path: Path, share: float
) -> None:
    first = train_segment(
        list_labelled(street), [], tmp_path / "first", replace(RECIPE, steps=2), log=lambda _: None
    )
    recipe = replace(RECIPE, steps=3, seed=5, start=str(first), learned=share)
    second = train_segment(list_labelled(street), [], tmp_path / "second", recipe, log=lambda _: None)
    trainer = Trainer(recipe, list_labelled(street))
    before, after = (unweigh(load_weights(path)[0].state_dict(), IN_STREETS) for path in (first, second))
    assert all(torch.equal(v, before[k]) for k, v in trainer.pupil.network.state_dict().items())
    trainer.resume(tmp_path / "second" / "checkpoint.safetensors")
    moved = 0
    for name, value in after.items():
        if value.is_floating_point():
            end = before[name] + share * (trainer.pupil.average.state_dict()[name] - before[name])
            assert torch.allclose(value, end, atol=1e-2, rtol=1e-3), name
            moved += not torch.allclose(value, before[name], atol=1e-5)
    assert moved > 10
    with pytest.raises(UsageError, match="another width"):
        Trainer(replace(recipe, width="small"), list_labelled(street))


def test_teachers_learn_of_labels_and_say_what_nobody_labelled(
    street: Path, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(loop, "TEACHERS", "tiny")
    refs = list_labelled(street)
    recipe = replace(RECIPE, teachers=2, steps=40, phases=(Phase(samples=SAMPLES, dropped=0.0),))
    batch = Samples(refs, TINY, 2, 0, SAMPLES).draw(np.random.default_rng(0))
    trainer = Trainer(recipe, refs)
    begun = [one.network.state_dict()["head.bias"].clone() for one in trainer.teachers]
    trainer.take_step(batch)
    for one, before in zip(trainer.teachers, begun, strict=True):
        assert not torch.equal(one.network.state_dict()["head.bias"], before)
    first, second = (
        torch.softmax(rows_of(one.average(batch.features, batch.sets)), 1) for one in trainer.teachers
    )
    said = trainer._said(batch.features, batch.sets)
    assert torch.allclose(said, (first + second) / 2, atol=2e-3) and not torch.allclose(
        first, second, atol=5e-3
    )

    fence = [c.name for c in CLASSES[1:20]].index("fence")
    wanted = torch.full_like(said, 0.005)
    wanted[:, fence] = 0.91
    monkeypatch.setattr(trainer, "_said", lambda *_: wanted)
    hidden = replace(batch, targets=torch.full_like(batch.targets, -1))
    for _ in range(25):
        assert trainer.take_step(hidden) == 0.0
    seen = batch.features[:, 0] != 0
    with torch.no_grad():
        found = torch.softmax(trainer.pupil.average(batch.features, batch.sets), 1)[:, fence][seen]
    assert found.mean() > 0.5
    trainer.save(tmp_path / "checkpoint.safetensors")
    resumed = Trainer(recipe, refs)
    resumed.resume(tmp_path / "checkpoint.safetensors")
    for one, other in zip(trainer.teachers, resumed.teachers, strict=True):
        states = one.average.state_dict(), other.average.state_dict()
        assert all(torch.equal(value, states[1][name]) for name, value in states[0].items())


def test_unlabelled_crops_come_from_scans_that_are_not_labelled_as_a_whole(street: Path) -> None:
    labelled, hidden = list_labelled(street)
    refs = [labelled, replace(hidden, labels=None)]
    samples = Samples(refs, TINY, 1, 0, replace(SAMPLES, unlabelled=1.0, pasted=0.0))
    rng = np.random.default_rng(0)
    drawn: list[int] = []
    scans = samples.scans
    assert scans[0].labelled > 0.5 and scans[1].labelled == 0
    for _ in range(8):
        crop = samples.crop(rng)
        assert not crop.classes.any() and (crop.planes[RANGE] > 0).any()
        drawn.append(next(reversed(scans._kept)))
    assert set(drawn) == {1}
    plain = Samples(refs, TINY, 1, 0, SAMPLES)
    assert all((plain.crop(rng).classes > 0).any() for _ in range(8))


def test_classes_count_as_in_streets_in_what_a_training_leaves(street: Path) -> None:
    trainer = Trainer(RECIPE, list_labelled(street))
    batch = Samples(trainer.refs, TINY, 2, 0, SAMPLES).draw(np.random.default_rng(0))
    with torch.no_grad():
        learned = torch.softmax(trainer.pupil.average(batch.features, batch.sets), 1)
        left = torch.softmax(trainer.averaged()(batch.features, batch.sets), 1)
    names = [c.name for c in CLASSES[1:20]]
    times = (left / learned) / (left / learned)[:, names.index("road"), None]
    for k, name in enumerate(names):
        assert torch.allclose(
            times[:, k], torch.tensor(IN_STREETS.get(name, 1.0)).expand_as(times[:, k]), rtol=1e-3
        )
    state = trainer.pupil.average.state_dict()
    back = unweigh(weigh(state, IN_STREETS), IN_STREETS)
    assert all(torch.allclose(value, back[name]) for name, value in state.items())
