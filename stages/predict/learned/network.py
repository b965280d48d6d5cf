"""The networks in exact arithmetic: float32 holding integers below 2 ** 24 (SENSOR_LATTICE.md, section 4).

Activations are integers 0..1023 (1/128 of a unit), weights integers with a power-of-two scale per
layer. No partial sum can reach 2 ** 24 (:func:`check` proves it when weights are loaded), so every
addition is exact and the order of summation does not matter.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, fields
from hashlib import sha256
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.features import LIMIT, SCALE

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Network:
    """Integer weights as float32; ``scales`` are the powers of two of the layers' weights.

    The first layer's bias is the sum of one row of each table in ``tables``, chosen by the laser and,
    for intensity, by the nearest intensities; the last layer's bias is a row of ``last_bias``.

    Attributes:
        first: ``(inputs, width)``; tables: ``(tables, rows, width)``; hidden: ``(layers *
        width, width)`` and hidden_bias ``(layers, width)``; last: ``(width, outputs)``; last_bias:
        ``(lasers, outputs)``; scales: ``(layers + 2,)``.
    """

    first: F32
    tables: F32
    hidden: F32
    hidden_bias: F32
    last: F32
    last_bias: F32
    scales: F32

    def arrays(self) -> tuple[F32, F32, F32, F32, F32, F32, F32]:
        """All arrays in the order the kernels take them."""
        return self.first, self.tables, self.hidden, self.hidden_bias, self.last, self.last_bias, self.scales

    @classmethod
    def empty(cls, inputs: int, outputs: int) -> Network:
        """A network of width 4 that answers 0 (for collecting training rows)."""
        shapes = ((inputs, 4), (3, 101, 4), (4, 4), (1, 4), (4, outputs), (64, outputs), (3,))
        return cls(*(np.zeros(shape, np.float32) for shape in shapes))

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the integer weights, whatever file they came from."""
        total = sha256()
        for field in fields(self):
            value = getattr(self, field.name)
            total.update(f"{field.name}{value.shape}".encode())
            total.update(np.ascontiguousarray(value).astype("<i4").tobytes())
        return total.hexdigest()


def load_network(path: Path) -> Network:
    """Read weights written by :func:`save_network`; raises SalpccError where they are damaged or not exact."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as stored:
            network = Network(*(np.ascontiguousarray(stored[f.name], np.float32) for f in fields(Network)))
        check(network)
    except Exception as error:  # NumPy meets damaged bytes with whatever comes to hand
        raise SalpccError(f"{path}: not weights of the coder ({error})") from error
    return network


def save_network(path: Path, network: Network) -> None:
    """Write the weights as integers; inverse of :func:`load_network`."""
    stored = {field.name: getattr(network, field.name).astype(np.int32) for field in fields(network)}
    np.savez_compressed(path, **stored)


def check(network: Network) -> None:
    """Raise SalpccError if some sum could leave the exact integers of float32."""
    layers = [
        (network.first, np.abs(network.tables).max(1).sum(0)),
        (network.last, np.abs(network.last_bias).max(0)),
    ]
    layers += [
        (w, np.abs(b))
        for w, b in zip(np.split(network.hidden, len(network.hidden_bias)), network.hidden_bias, strict=True)
    ]
    for weight, bias in layers:
        reach = np.abs(weight).astype(np.float64).sum(0) * LIMIT + bias
        if reach.max() >= 2.0**24 or (weight != np.floor(weight)).any():
            raise SalpccError(
                "network weights are not exact in float32: export them again with smaller scales"
            )


@njit(cache=True, error_model="numpy", inline="always")
def _layer(weight: F32, row: int, x: F32, n: int, acc: F32) -> None:
    """Add ``x[:n] @ weight[row : row + n]`` to ``acc``; n is a multiple of 8."""
    m = weight.shape[1]
    for k in range(0, n, 8):
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        x4, x5, x6, x7 = x[k + 4], x[k + 5], x[k + 6], x[k + 7]
        r0 = np.uint64(row + k)  # unsigned: no check for negative indices, so the loop vectorises
        r1, r2, r3 = np.uint64(row + k + 1), np.uint64(row + k + 2), np.uint64(row + k + 3)
        r4, r5, r6 = np.uint64(row + k + 4), np.uint64(row + k + 5), np.uint64(row + k + 6)
        r7 = np.uint64(row + k + 7)
        for j in range(m):
            low = (weight[r0, j] * x0 + weight[r1, j] * x1) + (weight[r2, j] * x2 + weight[r3, j] * x3)
            high = (weight[r4, j] * x4 + weight[r5, j] * x5) + (weight[r6, j] * x6 + weight[r7, j] * x7)
            acc[j] += low + high


@njit(cache=True, error_model="numpy", inline="always")
def _activate(acc: F32, n: int, scale: np.float32, h: F32) -> None:
    inverse = np.float32(1.0) / scale
    half = np.float32(0.5)
    limit = np.float32(LIMIT)
    zero = np.float32(0.0)
    for j in range(n):
        h[j] = min(max(np.floor(acc[j] * inverse + half), zero), limit)


@njit(cache=True, error_model="numpy", inline="always")
def forward(
    x: F32,
    laser: int,
    first: F32,
    hidden: F32,
    hidden_bias: F32,
    last: F32,
    last_bias: F32,
    scales: F32,
    h: F32,
    acc: F32,
    out: F32,
) -> None:
    """Run the network on integer features ``x``; fills ``out`` with real values (exact float32).

    ``acc`` holds the first layer's bias on entry; ``h`` is scratch of the same width.
    """
    width = first.shape[1]
    _layer(first, 0, x, len(x), acc)
    _activate(acc, width, scales[0], h)
    for layer in range(hidden_bias.shape[0]):
        for j in range(width):
            acc[j] = hidden_bias[layer, j]
        _layer(hidden, layer * width, h, width, acc)
        _activate(acc, width, scales[1 + layer], h)
    n = last.shape[1]
    for j in range(n):
        out[j] = last_bias[np.uint64(laser), j]
    _layer(last, 0, h, width, out)
    inverse = np.float32(1.0) / (scales[len(scales) - 1] * np.float32(SCALE))
    for j in range(n):
        out[j] *= inverse
