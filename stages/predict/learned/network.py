"""The networks in whole numbers: int16 weights and activations, int32 sums (docs/sensor_lattice.md, section 4).

Activations are integers 0..1023 (1/128 of a unit), weights integers with a power-of-two scale per layer. No
partial sum can reach 2 ** 24 (:func:`check` proves it when weights are loaded): sums need no care for overflow, their
order does not matter, and what a network answers is exact in float32, too.

Two inputs are taken at once, for blocks of outputs side by side (:mod:`.vectors`): one instruction multiplies
and adds 32 weights where a machine has vectors of 512 bits. Weights are read once for POINTS points.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, fields
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.range_features import LIMIT
from salpcc.stages.vectors import (
    cast,
    dot,
    inline,
    larger,
    load,
    pairs,
    smaller,
    store,
)

I16 = NDArray[np.int16]
I32 = NDArray[np.int32]

POINTS = 4  # that are evaluated at once: each weight is read once for all of them
BLOCK = 16  # outputs of a layer come in multiples of it
NEVER = -(1 << 30)  # what an output that is none answers
_LIMIT, _ZERO = np.int32(LIMIT), np.int32(0)
_REACH = 1 << 24
_LINE = 64


@dataclass(frozen=True, eq=False)
class Network:
    """Integer weights as trained and stored; ``scales`` are the powers of two of the layers' weights.

    The first layer's bias is the sum of one row of each table in ``tables``, chosen by the laser and,
    for intensity, by the nearest intensities; the last layer's bias is a row of ``last_bias``.

    Attributes:
        first: ``(inputs, width)`` int32, as all; tables: ``(tables, rows, width)``; hidden: ``(layers *
        width, width)`` and hidden_bias ``(layers, width)``; last: ``(width, outputs)``; last_bias:
        ``(lasers, outputs)``; scales: ``(layers + 2,)``.
    """

    first: I32
    tables: I32
    hidden: I32
    hidden_bias: I32
    last: I32
    last_bias: I32
    scales: I32

    @classmethod
    def empty(cls, inputs: int) -> Network:
        """A network that answers 0 (for collecting training rows)."""
        nothing = np.zeros((1, 1), np.int32)
        first, tables = np.zeros((inputs, 1), np.int32), np.zeros((4, 1, 1), np.int32)
        return cls(first, tables, nothing, nothing, nothing, nothing, np.ones(3, np.int32))

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the integer weights, whatever file they came from."""
        total = sha256()
        for field in fields(self):
            value = getattr(self, field.name)
            total.update(f"{field.name}{value.shape}".encode())
            total.update(np.ascontiguousarray(value).astype("<i4").tobytes())
        return total.hexdigest()


class Layers(NamedTuple):
    """The same weights as the kernels take them.

    Widths are padded to multiples of BLOCK; weights stand as the sums are made, :func:`_in_blocks`: ``first`` is
    ``(inputs / 2, width * 2)`` int16, ``hidden`` ``(layers * width / 2, width * 2)``, ``last`` ``(width / 2, outputs * 2)``. Tables and biases
    are int32; ``shifts`` the binary logarithms of the scales.
    """

    first: I16
    tables: I32
    hidden: I16
    hidden_bias: I32
    last: I16
    last_bias: I32
    shifts: I32


def load_network(path: Path) -> Network:
    """Read weights written by :func:`save_network`; raises SalpccError where they are damaged or not exact."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as stored:
            network = Network(*(np.ascontiguousarray(stored[f.name], np.int32) for f in fields(Network)))
        check(network)
    except Exception as error:  # NumPy meets damaged bytes with whatever comes to hand
        raise SalpccError(f"{path}: not weights of the coder ({error})") from error
    return network


def save_network(path: Path, network: Network) -> None:
    """Write the weights; inverse of :func:`load_network`."""
    np.savez_compressed(path, **{field.name: getattr(network, field.name) for field in fields(network)})


def check(network: Network) -> None:
    """Raise SalpccError if a weight does not fit int16, or some sum could reach 2 ** 24."""
    layers = [
        (network.first, np.abs(network.tables.astype(np.int64)).max(1).sum(0)),
        (network.last, np.abs(network.last_bias.astype(np.int64)).max(0)),
    ]
    hidden = np.split(network.hidden, len(network.hidden_bias))
    layers += [(w, np.abs(b.astype(np.int64))) for w, b in zip(hidden, network.hidden_bias, strict=True)]
    for weight, bias in layers:
        size = np.abs(weight.astype(np.int64))
        if (size.sum(0) * int(LIMIT) + bias).max() >= _REACH or size.max() >= 1 << 15:
            raise SalpccError(
                "network weights are too large to be exact: export them again with smaller scales"
            )
    if (network.scales < 1).any() or (network.scales & (network.scales - 1)).any():
        raise SalpccError("scales of a network are powers of two")


@lru_cache(maxsize=16)
def pack(network: Network, inputs: tuple[int, ...], places: tuple[int, ...]) -> Layers:
    """Lay the weights out for the kernels: input n comes to stand at ``inputs[n]``, output n at ``places[n]``.

    What is beyond ``inputs`` and ``places`` is left out; what stands at no place answers NEVER.
    """
    first = np.zeros((-(-(max(inputs) + 1) // 4) * 4, network.first.shape[1]), np.int32)
    first[list(inputs)] = network.first[: len(inputs)]
    width = _padded(network.first.shape[1])
    outputs = _padded(max(places) + 1)
    last = np.zeros((len(network.last), outputs), np.int32)
    last_bias = np.full((len(network.last_bias), outputs), NEVER, np.int32)
    last[:, places[: network.last.shape[1]]] = network.last[:, : len(places)]
    last_bias[:, places[: network.last.shape[1]]] = network.last_bias[:, : len(places)]
    hidden = np.split(network.hidden, len(network.hidden_bias))
    return Layers(
        first=aligned(_in_blocks(first, width)),
        tables=aligned(_wide(network.tables, width)),
        hidden=aligned(np.concatenate([_in_blocks(_tall(weight, width), width) for weight in hidden])),
        hidden_bias=aligned(_wide(network.hidden_bias, width)),
        last=aligned(_in_blocks(_tall(last, width), outputs)),
        last_bias=aligned(last_bias),
        shifts=np.log2(network.scales).astype(np.int32),
    )


def _padded(n: int) -> int:
    return -(-n // BLOCK) * BLOCK


def _wide(array: I32, width: int) -> I32:
    return np.pad(array, [(0, 0)] * (array.ndim - 1) + [(0, width - array.shape[-1])])


def _tall(array: I32, height: int) -> I32:
    return np.pad(array, ((0, height - len(array)), (0, 0)))


def _in_blocks(weight: I32, width: int) -> I16:
    """``(inputs, outputs)`` as blocks of outputs, one behind the other, each ``[pair of inputs][output][2]``."""
    wide = _wide(weight, width).astype(np.int16)
    blocks, j = [], 0
    while j < width:  # as _layer takes them
        left = width - j
        outputs = 32 if left >= 32 else 16
        block = wide[:, j : j + outputs].reshape(-1, 2, outputs).transpose(0, 2, 1)
        blocks.append(block.reshape(-1))
        j += outputs
    return np.concatenate(blocks).reshape(-1, 2 * width)


def aligned(array: NDArray[Any]) -> NDArray[Any]:
    """A copy that begins where a line of the processor's cache does: vectors that straddle two take twice as long."""
    room = np.empty(array.nbytes + _LINE, np.uint8)
    start = -room.ctypes.data % _LINE
    copy = room[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[:] = array
    return copy


@inline
def _two_blocks(weight: I16, w: int, x: I16, at: int, apart: int, inputs: int, sums: I32, j: int) -> None:
    row = sums.shape[1]
    j1, j2, j3 = j + row, j + 2 * row, j + 3 * row
    s0, s1, s2, s3 = load(sums, j, 16), load(sums, j1, 16), load(sums, j2, 16), load(sums, j3, 16)
    t0, t1, t2, t3 = (
        load(sums, j + 16, 16),
        load(sums, j1 + 16, 16),
        load(sums, j2 + 16, 16),
        load(sums, j3 + 16, 16),
    )
    for k in range(at, at + inputs, 2):
        a, b = load(weight, w, 32), load(weight, w + 32, 32)
        x0, x1 = pairs(x, k, 32), pairs(x, k + apart, 32)
        x2, x3 = pairs(x, k + 2 * apart, 32), pairs(x, k + 3 * apart, 32)
        s0 = s0 + dot(a, x0)
        t0 = t0 + dot(b, x0)
        s1 = s1 + dot(a, x1)
        t1 = t1 + dot(b, x1)
        s2 = s2 + dot(a, x2)
        t2 = t2 + dot(b, x2)
        s3 = s3 + dot(a, x3)
        t3 = t3 + dot(b, x3)
        w += 64
    store(sums, j, s0)
    store(sums, j + 16, t0)
    store(sums, j1, s1)
    store(sums, j1 + 16, t1)
    store(sums, j2, s2)
    store(sums, j2 + 16, t2)
    store(sums, j3, s3)
    store(sums, j3 + 16, t3)


@inline
def _block(weight: I16, w: int, x: I16, at: int, apart: int, inputs: int, sums: I32, j: int) -> None:
    row = sums.shape[1]
    j1, j2, j3 = j + row, j + 2 * row, j + 3 * row
    s0, s1, s2, s3 = load(sums, j, 16), load(sums, j1, 16), load(sums, j2, 16), load(sums, j3, 16)
    for k in range(at, at + inputs, 2):
        a = load(weight, w, 32)
        s0 = s0 + dot(a, pairs(x, k, 32))
        s1 = s1 + dot(a, pairs(x, k + apart, 32))
        s2 = s2 + dot(a, pairs(x, k + 2 * apart, 32))
        s3 = s3 + dot(a, pairs(x, k + 3 * apart, 32))
        w += 32
    store(sums, j, s0)
    store(sums, j1, s1)
    store(sums, j2, s2)
    store(sums, j3, s3)


@inline
def _layer(weight: I16, row: int, x: I16, at: int, apart: int, inputs: int, sums: I32) -> None:
    """Add ``x @ weight``, which starts at row ``row``, to the ``sums`` of POINTS points, whose ``inputs`` stand ``apart`` from ``x[at]`` on."""
    outputs = weight.shape[1] >> 1
    w = row * weight.shape[1]
    even = outputs & -32
    for j in range(0, even, 32):
        _two_blocks(weight, w + inputs * j, x, at, apart, inputs, sums, j)
    if outputs > even:
        _block(weight, w + inputs * even, x, at, apart, inputs, sums, even)


@inline
def _activate(sums: I32, n: int, shift: np.int32, h: I16) -> None:
    """``h = clip(floor(sums / 2^shift + 1/2), 0, LIMIT)`` of POINTS points."""
    half = np.int32((1 << shift) >> 1)
    for p in range(POINTS):
        for j in range(0, n, 16):
            h_j = larger(smaller((load(sums, p * sums.shape[1] + j, 16) + half) >> shift, _LIMIT), _ZERO)
            store(h, p * n + j, cast(h_j, np.int16))


@inline
def begin(sums: I32, p: int, bias: I32, at: int, n: int) -> None:
    """Let the ``n`` sums of point ``p`` begin with a bias, from flat index ``at``."""
    for j in range(0, n, 16):
        store(sums, p * sums.shape[1] + j, load(bias, at + j, 16))


@inline
def forward(x: I16, at: int, lasers: NDArray[np.int64], layers: Layers, h: I16, sums: I32) -> None:
    """Run the network on the features of POINTS points, -LIMIT..LIMIT, rows ``at`` and after of ``x``; ``h`` ``(POINTS, width)`` is scratch.

    ``sums``, a row a point, holds the first layer's biases on entry, the last layer's sums on return: what the network
    answers, in units of ``1 / (SCALE * last scale)``. ``lasers`` are those of the rows of ``x``.
    """
    width, outputs = layers.first.shape[1] >> 1, layers.last.shape[1] >> 1
    apart = x.shape[1]
    _layer(layers.first, 0, x, at * apart, apart, 2 * layers.first.shape[0], sums)
    _activate(sums, width, layers.shifts[0], h)
    for layer in range(layers.hidden_bias.shape[0]):
        for p in range(POINTS):
            begin(sums, p, layers.hidden_bias, layer * width, width)
        _layer(layers.hidden, layer * (width >> 1), h, 0, width, width, sums)
        _activate(sums, width, layers.shifts[1 + layer], h)
    for p in range(POINTS):
        begin(sums, p, layers.last_bias, lasers[at + p] * outputs, outputs)
    _layer(layers.last, 0, h, 0, width, width, sums)
