"""Turn trained float weights into the exact integer network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.learned.network import Network
from salpcc.stages.predict.learned.range_features import LIMIT, SCALE

F64 = NDArray[np.float64]

_ROOM = 2.0**24 * 0.98
_LARGEST = 2.0**15 - 1  # weight
_FINEST = 12  # log2 of the largest scale


def _scale(weight: F64, bias: F64) -> float:
    """Largest power of two that keeps every possible sum exact, rounding included, and weights in 16 bits."""
    rounding = 0.5 * weight.shape[0] * LIMIT + 2.0
    reach = (np.abs(weight).sum(0) * LIMIT + np.abs(bias) * SCALE).max()
    room = min((_ROOM - rounding) / reach, _LARGEST / np.abs(weight).max(initial=1e-9))
    return float(2.0 ** min(_FINEST, np.floor(np.log2(room))))


def quantize_network(
    layers: list[tuple[F64, F64]], tables: list[F64], last_table: F64 | None = None
) -> Network:
    """Round float weights.

    ``layers`` are (weight (inputs, outputs), bias (outputs,)); ``tables`` (rows, width) add to the
    first layer by index; ``last_table`` (lasers, outputs) adds to the last.
    """
    rows = max(len(table) for table in tables)
    stacked = np.stack([np.pad(table, ((0, rows - len(table)), (0, 0))) for table in tables])
    stacked[0] += layers[0][1]
    biases = [np.abs(stacked).max(1).sum(0)]
    biases += [bias for _, bias in layers[1:-1]]
    last_bias = layers[-1][1][None] + (last_table if last_table is not None else np.zeros((rows, 1)))
    biases.append(np.abs(last_bias).max(0))
    scales = [_scale(weight, bias) for (weight, _), bias in zip(layers, biases, strict=True)]
    whole = [
        np.ascontiguousarray(np.rint(weight * s), np.int32)
        for (weight, _), s in zip(layers, scales, strict=True)
    ]
    hidden_bias = [np.rint(bias * s * SCALE) for (_, bias), s in zip(layers[1:-1], scales[1:-1], strict=True)]
    return Network(
        first=whole[0],
        tables=np.rint(stacked * scales[0] * SCALE).astype(np.int32),
        hidden=np.concatenate(whole[1:-1]),
        hidden_bias=np.stack(hidden_bias).astype(np.int32),
        last=whole[-1],
        last_bias=np.rint(last_bias * scales[-1] * SCALE).astype(np.int32),
        scales=np.array(scales, np.int32),
    )
