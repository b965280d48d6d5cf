"""The network in whole numbers: exact against 64-bit integers, and what its rounded form was trained as."""

import numpy as np
import pytest
import torch

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.paper.st_lstm.arithmetic import (
    ONE,
    TOP,
    Exact,
    Layer,
    Trainable,
    sigmoid_table,
    tanh_table,
)
from salpcc.stages.predict.paper.st_lstm.checkpoint import digest, export, load, save
from salpcc.stages.predict.paper.st_lstm.inputs import N_FEATURES
from salpcc.stages.predict.paper.st_lstm.network import Shape, first_state, from_patches, step, to_patches

SMALL = Shape(width=8, depth=2, handed=2, head=8)


class Oracle(Exact):
    """The same network in int64."""

    def convolve(self, name: str, *parts: torch.Tensor) -> torch.Tensor:
        layer = self._layers[name]
        x = np.concatenate([p[0].numpy().astype(np.int64) for p in parts])
        weight = layer.weight.numpy().astype(np.int64)
        reach = weight.shape[2] // 2
        x = np.pad(np.pad(x, ((0, 0), (0, 0), (reach, reach)), mode="wrap"), ((0, 0), (reach, reach), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(x, weight.shape[2:], axis=(1, 2))
        total = (
            np.einsum("ihwab,oiab->ohw", windows, weight) + layer.bias.numpy().astype(np.int64)[:, None, None]
        )
        return torch.from_numpy(total.astype(np.float64) / 2.0**layer.bits)[None]

    def _look_up(self, table: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        return super()._look_up(table.double(), x)


def random_layers(seed: int) -> tuple[Trainable, dict[str, Layer]]:
    torch.manual_seed(seed)
    numbers = Trainable(SMALL.layers())
    with torch.no_grad():
        for parameter in numbers.parameters():
            parameter.mul_(3.0)
    numbers.settle()
    return numbers, export(numbers)


def random_features(seed: int, columns: int = 64) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.integers(-TOP, TOP + 1, (1, N_FEATURES, 64, columns))).float()


def test_whole_numbers_are_exact() -> None:
    _, layers = random_layers(1)
    exact, oracle = Exact(layers), Oracle(layers)
    state, truth = (first_state(SMALL, random_features(0)) for _ in range(2))
    with torch.inference_mode():
        for number in range(3):
            features = random_features(number)
            shares, spread, state = step(exact, SMALL, features, state)
            true_shares, true_spread, truth = step(oracle, SMALL, features.double(), truth)
            assert torch.equal(shares.double(), true_shares.double())
            assert torch.equal(spread.double(), true_spread.double())
            assert torch.equal(state.spatial.double(), truth.spatial.double())
    assert shares.abs().max() > 0.1 and state.highway.abs().max() > 1  # not all zeros


def test_the_rounded_network_has_the_same_values() -> None:
    numbers, layers = random_layers(2)
    exact = Exact(layers)
    features = random_features(5)
    with torch.inference_mode():
        rounded_shares, rounded_spread, _ = step(numbers, SMALL, features / ONE, first_state(SMALL, features))
        shares, spread, _ = step(exact, SMALL, features, first_state(SMALL, features))
    # The float sums may fall to the other side of a rounding; that must be rare.
    assert ((shares - rounded_shares).abs() < 0.01).float().mean() > 0.99
    assert ((spread - rounded_spread).abs() < 0.1).float().mean() > 0.99


@pytest.mark.parametrize("table", [sigmoid_table(), tanh_table()])
def test_tables_do_not_hang_on_the_last_bit(table: list[float]) -> None:
    off = np.abs(np.array(table) % 1.0 - 0.5)
    assert off.min() > 1e-9


def test_weights_that_could_overflow_are_refused() -> None:
    weight = torch.full((1, 300, 3, 3), 255.0)
    with pytest.raises(SalpccError, match="not exact"):
        Exact({"a": Layer(weight, torch.zeros(1), 8)})
    with pytest.raises(SalpccError, match="not exact"):
        Exact({"a": Layer(torch.full((1, 1, 1, 1), 0.5), torch.zeros(1), 8)})


def test_patches_and_back() -> None:
    x = torch.arange(2 * 3 * 64 * 80).reshape(2, 3, 64, 80)
    assert to_patches(x).shape == (2, 96, 16, 10)
    assert torch.equal(from_patches(to_patches(x)), x)


def test_weights_come_back_from_their_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    _, layers = random_layers(3)
    save(tmp_path / "w.safetensors", layers, SMALL)
    again, shape = load(tmp_path / "w.safetensors")
    assert shape == SMALL and digest(again) == digest(layers)
    (tmp_path / "bad.safetensors").write_bytes(b"nothing of the kind")
    with pytest.raises(SalpccError, match="cannot be read"):
        load(tmp_path / "bad.safetensors")
