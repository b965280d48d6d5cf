"""The network is exact: the kernel equals integer arithmetic, weights that are not exact are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.export import quantize_network
from salpcc.stages.predict.learned.models import EFFORTS, load_models
from salpcc.stages.predict.learned.network import Network, check, forward, load_network, save_network


def in_integers(network: Network, x: np.ndarray, laser: int) -> np.ndarray:
    """The same network in int64, the oracle."""
    w = [a.astype(np.int64) for a in network.arrays()]
    first, tables, hidden, hidden_bias, last, last_bias, scales = w
    total = x.astype(np.int64) @ first + tables[0, laser]
    h = np.clip((2 * total + scales[0]) // (2 * scales[0]), 0, 1023)
    for layer, weight in enumerate(np.split(hidden, len(hidden_bias))):
        s = scales[1 + layer]
        h = np.clip((2 * (h @ weight + hidden_bias[layer]) + s) // (2 * s), 0, 1023)
    return (h @ last + last_bias[laser]) / (scales[-1] * 128)


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("which", ["ranges", "intensity"])
def test_forward_equals_integer_arithmetic(effort: str, which: str) -> None:
    network: Network = getattr(load_models(effort), which)
    rng = np.random.default_rng(5)
    width, outputs = network.last.shape
    for laser in (0, 31, 63):
        x = rng.integers(-1023, 1024, len(network.first)).astype(np.float32)
        acc = network.tables[0, laser].copy()
        h, out = np.zeros(width, np.float32), np.zeros(outputs, np.float32)
        first, _, hidden, hidden_bias, last, last_bias, scales = network.arrays()
        forward(x, laser, first, hidden, hidden_bias, last, last_bias, scales, h, acc, out)
        np.testing.assert_array_equal(out, in_integers(network, x, laser).astype(np.float32))


def small() -> Network:
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=s), rng.normal(size=s[1])) for s in ((16, 8), (8, 8), (8, 8))]
    return quantize_network(layers, [rng.normal(size=(64, 8))])


def test_weights_come_back_from_a_file(tmp_path: Path) -> None:
    network = small()
    save_network(tmp_path / "w.npz", network)
    back = load_network(tmp_path / "w.npz")
    assert back.digest == network.digest
    for a, b in zip(network.arrays(), back.arrays(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_digest_names_the_weights() -> None:
    network = small()
    other = replace(network, last=network.last + 1)
    assert other.digest != network.digest


@pytest.mark.parametrize("field", ["first", "hidden", "last", "tables", "last_bias"])
def test_inexact_weights_are_refused(field: str) -> None:
    network = small()
    with pytest.raises(SalpccError, match="not exact"):
        check(replace(network, **{field: getattr(network, field) * np.float32(2**20)}))


def test_unknown_effort_is_refused() -> None:
    with pytest.raises(SalpccError, match="effort 'fast'"):
        load_models("fast")
