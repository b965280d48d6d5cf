"""The shipped network on made-up and real frames: same bytes everywhere, and better than the last frame."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import torch

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.predict.paper.st_lstm import Memory, load_model, predict_frame
from salpcc.stages.predict.paper.st_lstm.checkpoint import SHIPPED
from salpcc.stages.predict.paper.st_lstm.dataset import read_clips
from salpcc.stages.predict.paper.st_lstm.inputs import N_FEATURES
from salpcc.stages.predict.paper.st_lstm.network import first_state, step

MOTION = np.array([-1.1, 0.01, -0.02, 1e-3, 2e-3, 0.01])


def frames(count: int) -> list[np.ndarray]:
    """Made-up frames: waves of depth that come nearer, with holes."""
    rng = np.random.default_rng(0)
    column = np.arange(COLUMNS)
    made = []
    for number in range(count):
        wall = 14_000 + 5_000 * np.sin(column / 90.0) - 900 * number
        image = np.broadcast_to(wall, (ROWS, COLUMNS)) + rng.normal(0, 15, (ROWS, COLUMNS))
        image = np.where(rng.random((ROWS, COLUMNS)) < 0.8, image, 0)
        made.append(image.astype(np.int32))
    return made


def answers(images: list[np.ndarray], device: str = "cpu") -> str:
    """Hash of what is predicted after each image."""
    model = load_model(device=device)
    memory: Memory | None = None
    total = sha256()
    for image in images:
        found, memory = predict_frame(memory, image, MOTION, model=model)
        total.update(found.ranges.tobytes() + found.spread.tobytes())
    return total.hexdigest()


def test_one_and_two_threads_give_the_same_bytes() -> None:
    """Of the whole network on a fifth of a frame: what lies around it is NumPy and one-threaded kernels."""
    model = load_model()
    rng = np.random.default_rng(0)
    features = torch.from_numpy(rng.integers(-256, 257, (1, N_FEATURES, ROWS, 400))).float()
    before = torch.get_num_threads()
    found = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.inference_mode():
                shares, spread, _ = step(
                    model.numbers, model.shape, features, first_state(model.shape, features)
                )
            found.append(shares.numpy().tobytes() + spread.numpy().tobytes())
    finally:
        torch.set_num_threads(before)
    assert found[0] == found[1]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_a_gpu_gives_the_same_bytes() -> None:
    assert answers(frames(3), "cuda") == answers(frames(3))


def test_memory_is_not_changed_and_counts() -> None:
    images = frames(3)
    first, memory = predict_frame(None, images[0], MOTION)
    once, _ = predict_frame(memory, images[1], MOTION)
    twice, _ = predict_frame(memory, images[1], MOTION)
    fresh, _ = predict_frame(None, images[1], MOTION)
    np.testing.assert_array_equal(once.ranges, twice.ranges)
    np.testing.assert_array_equal(once.spread, twice.spread)
    assert (once.ranges != fresh.ranges).any()
    assert first.ranges.dtype == np.int32 and first.spread.dtype == np.uint8 and first.spread.max() < 16


def test_an_empty_frame_is_answered_by_none() -> None:
    empty = np.zeros((ROWS, COLUMNS), np.int32)
    found, memory = predict_frame(None, empty, None)
    assert not found.ranges.any()
    again, _ = predict_frame(memory, frames(1)[0], None)
    assert again.ranges.any()


def test_shipped_weights_are_small() -> None:
    assert SHIPPED.stat().st_size < 10_000_000


def test_real_scans_are_predicted_better_than_by_the_last_frame(real_data: Path, tmp_path: Path) -> None:
    """Sequence 06, which the network was not trained on."""
    (tmp_path / "sequences").mkdir()
    (tmp_path / "sequences" / "06").symlink_to(real_data / "semantickitti" / "sequences" / "06")
    (clip,) = read_clips(tmp_path)
    memory: Memory | None = None
    cost: dict[str, list[float]] = {"last": [], "warped": [], "network": []}
    for number, motion in enumerate(clip.motions[:3]):
        found, memory = predict_frame(memory, clip.frames[number], motion, clip.elevation)
        new, base = clip.frames[number + 1], clip.inputs[number].base
        seen = (new > 0) & (clip.frames[number] > 0) & (base > 0)
        for name, guess in (("last", clip.frames[number]), ("warped", base), ("network", found.ranges)):
            cost[name].append(float(np.log2(1.0 + np.abs(new - guess)[seen]).mean()))
    last, warped, network = (float(np.mean(cost[name])) for name in ("last", "warped", "network"))
    assert warped < last - 0.3
    assert network < warped - 0.2
