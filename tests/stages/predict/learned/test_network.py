"""The network is exact: the kernel equals integer arithmetic, weights that are not exact are refused."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.network import (
    NEVER,
    POINTS,
    Layers,
    Network,
    check,
    forward,
    load_network,
    pack,
    save_network,
)
from salpcc.stages.predict.learned.quantise import quantize_network
from salpcc.stages.predict.learned.shipped import EFFORTS, load_models


def in_integers(network: Network, x: np.ndarray, bias: np.ndarray, laser: int) -> np.ndarray:
    """The same network in int64, from its stored weights: the oracle."""
    first, _, hidden, hidden_bias, last, last_bias, scales = (
        getattr(network, field.name).astype(np.int64) for field in fields(network)
    )
    total = x.astype(np.int64) @ first + bias
    h = np.clip((2 * total + scales[0]) // (2 * scales[0]), 0, 1023)
    for layer, weight in enumerate(np.split(hidden, len(hidden_bias))):
        s = scales[1 + layer]
        h = np.clip((2 * (h @ weight + hidden_bias[layer]) + s) // (2 * s), 0, 1023)
    return h @ last + last_bias[laser]


@njit(error_model="numpy")
def run(x: np.ndarray, lasers: np.ndarray, layers: Layers, h: np.ndarray, sums: np.ndarray) -> None:
    forward(x, 1, lasers, layers, h, sums)


def answer(
    network: Network, x: np.ndarray, bias: np.ndarray, lasers: np.ndarray, inputs: tuple, places: tuple
) -> np.ndarray:
    """What the kernel answers, at its places, to the rows of ``x`` ``(POINTS, inputs)`` with their biases and lasers."""
    layers = pack(network, inputs, places)
    moved = np.full((1 + POINTS, 2 * len(layers.first) + 3), 77, np.int16)
    moved[1:, : 2 * len(layers.first)] = 0
    moved[1:, list(inputs)] = x
    width, outputs = layers.first.shape[1] // 2, layers.last.shape[1] // 2
    sums = np.zeros((POINTS, max(width, outputs) + 16), np.int32)
    sums[:, : bias.shape[1]] = bias
    run(moved, np.append(0, lasers), layers, np.zeros((POINTS, width), np.int16), sums)
    return sums[:, :outputs]


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("which", ["ranges", "intensity"])
@pytest.mark.parametrize("extreme", [False, True])
def test_forward_equals_integer_arithmetic(effort: str, which: str, extreme: bool) -> None:
    network: Network = getattr(load_models(effort), which)
    rng = np.random.default_rng(5)
    inputs = tuple(rng.permutation(len(network.first) + 9)[: len(network.first)].tolist())
    outputs = network.last.shape[1]
    places = tuple(rng.permutation(outputs + 20)[: outputs - 2].tolist())
    lasers = np.array([0, 31, 63, 5])
    x = rng.integers(-1023, 1024, (POINTS, len(network.first)))
    if extreme:
        x = np.where(x < 0, -1023, 1023)
    bias = network.tables[0, lasers]
    found = answer(network, x, bias, lasers, inputs, places)
    for p in range(POINTS):
        wanted = in_integers(network, x[p], bias[p], lasers[p])
        np.testing.assert_array_equal(found[p, list(places)], wanted[: outputs - 2])
    others = np.ones(found.shape[1], bool)
    others[list(places)] = False
    assert (found[:, others] == NEVER).all()


@pytest.mark.parametrize("width", [8, 16, 32, 48, 64, 80, 112, 128, 144])
def test_any_width_is_exact(width: int) -> None:
    rng = np.random.default_rng(width)
    layers = [
        (rng.normal(size=s) / 9, rng.normal(size=s[1])) for s in ((13, width), (width, width), (width, 5))
    ]
    network = quantize_network(layers, [rng.normal(size=(64, width))])
    x, lasers = rng.integers(-1023, 1024, (POINTS, 13)), np.array([7, 0, 63, 7])
    bias = network.tables[0, lasers]
    found = answer(network, x, bias, lasers, tuple(range(13)), tuple(range(5)))
    for p in range(POINTS):
        np.testing.assert_array_equal(found[p, :5], in_integers(network, x[p], bias[p], lasers[p]))


def small() -> Network:
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=s), rng.normal(size=s[1])) for s in ((16, 8), (8, 8), (8, 8))]
    return quantize_network(layers, [rng.normal(size=(64, 8))])


def test_weights_come_back_from_a_file(tmp_path: Path) -> None:
    network = small()
    save_network(tmp_path / "w.npz", network)
    back = load_network(tmp_path / "w.npz")
    assert back.digest == network.digest
    for field in fields(network):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(network, field.name))


def test_digest_names_the_weights() -> None:
    network = small()
    other = replace(network, last=network.last + 1)
    assert other.digest != network.digest


@pytest.mark.parametrize("field", ["first", "hidden", "last", "tables", "last_bias"])
def test_inexact_weights_are_refused(field: str) -> None:
    network = small()
    with pytest.raises(SalpccError, match="too large to be exact"):
        check(replace(network, **{field: getattr(network, field) << 16}))


@pytest.mark.parametrize("field", ["first", "hidden", "last"])
def test_a_weight_beyond_16_bits_is_refused(field: str) -> None:
    network = small()
    weight = np.zeros_like(getattr(network, field))
    check(replace(network, **{field: weight}))
    weight[0, 0] = 1 << 15
    with pytest.raises(SalpccError, match="too large"):
        check(
            replace(
                network, **{field: weight, "tables": network.tables * 0, "last_bias": network.last_bias * 0}
            )
        )


def test_a_scale_that_is_no_power_of_two_is_refused() -> None:
    network = small()
    with pytest.raises(SalpccError, match="powers of two"):
        check(replace(network, scales=network.scales + 1))


def test_export_keeps_weights_in_16_bits() -> None:
    """One large weight alone needs no small scale for its sum, but for its own bits."""
    layers = [(np.full((1, 8), 14.0), np.zeros(8)), (np.eye(8), np.zeros(8)), (np.eye(8), np.zeros(8))]
    network = quantize_network(layers, [np.zeros((64, 8))])
    check(network)
    assert network.first.max() < 1 << 15


def test_unknown_effort_is_refused() -> None:
    with pytest.raises(SalpccError, match="effort 'fast'"):
        load_models("fast")
