"""Turn trained float weights into the exact integer network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.learned.features import LIMIT, SCALE
from salpcc.stages.predict.learned.network import Network

_ROOM = 2.0**24 * 0.98


def _scale(weight: NDArray[np.float64], bias: NDArray[np.float64]) -> float:
    """Largest power of two that keeps every possible sum exact."""
    reach = np.abs(weight).sum(0).max() * LIMIT + np.abs(bias).max() * SCALE + weight.shape[0] * LIMIT
    return float(2.0 ** min(12, np.floor(np.log2(_ROOM / reach))))


def quantize_network(state: dict[str, NDArray[np.float64]], layers: int) -> Network:
    """``state``: l.k.weight (out, in), l.k.bias, e.weight (lasers, width), o.weight, o.bias."""
    scales, weights, biases = [], [], []
    names = [f"l.{k}" for k in range(layers)] + ["o"]
    for k, name in enumerate(names):
        w = state[f"{name}.weight"].T
        b = state[f"{name}.bias"][None] + (state["e.weight"] if k == 0 else 0.0)
        s = _scale(w, b)
        scales.append(s)
        weights.append(np.ascontiguousarray(np.rint(w * s), np.float32))
        biases.append(np.rint(b * s * SCALE).astype(np.float32))
    return Network(
        first=weights[0],
        embedding=biases[0],
        hidden=np.stack(weights[1:-1]),
        hidden_bias=np.concatenate(biases[1:-1]),
        last=weights[-1],
        last_bias=biases[-1][0],
        scales=np.array(scales, np.float32),
    )
