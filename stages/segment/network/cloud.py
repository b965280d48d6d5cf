"""The 3-D branch as labelling runs it on a CPU: the sums of :mod:`.point_branch`, a neighbour's own part but once.

The first convolution of a group of neighbours is linear in what each neighbour is and in where it lies. So what it
is goes through once for every point, not for every group it is in, and no joined rows are ever written.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from salpcc.stages.segment.network.bfloat16 import Numbers, put
from salpcc.stages.segment.network.point_branch import SCALES
from salpcc.stages.segment.network.sampling import PointSets

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


class Cloud:
    """The 3-D branch ``points`` of a :class:`~salpcc.stages.segment.network.fused.FusedNetwork`."""

    def __init__(self, points: Any) -> None:
        self.encoders = [
            (
                near.weight[:, :3].T.contiguous().numpy(),
                near.weight[:, 3:].contiguous(),
                near.bias,
                deep.weight.T.contiguous(),
                deep.bias.numpy(),
            )
            for near, deep in (block.linear for block in points.encoders)
        ]
        self.decoders = points.decoders

    def first_level(self, points: F32, sets: PointSets) -> Tensor:
        """Return what ``PointBranch.first_level`` does of source points ``(P, 5)``: features ``(M, widths[0])``."""
        where, features = np.ascontiguousarray(points[:, :3]), torch.from_numpy(points[:, 3:])
        levels = []
        for (place, kind, bias, deep, shift), scale, centres, groups in zip(
            self.encoders, SCALES, sets.centres, sets.groups, strict=True
        ):
            here = np.ascontiguousarray(points[centres, :3])
            own = functional.linear(features, kind, bias).numpy()
            near = torch.from_numpy(_neighbours(own, where, here, groups, place, np.float32(scale)))
            features = torch.from_numpy(_largest((near @ deep).numpy(), shift, groups.shape[1]))
            where = here
            levels.append(features)
        up = levels[-1]
        for level in range(len(levels) - 2, -1, -1):
            parents, weights = map(torch.from_numpy, (sets.parents[level], sets.weights[level]))
            lifted = functional.embedding_bag(parents, up, per_sample_weights=weights, mode="sum")
            up = self.decoders[level](torch.cat([levels[level], lifted], -1))
        return up


@njit(cache=True)
def mixed(rows: F32, parents: I64, weights: F32, side: int, out: Numbers) -> None:
    """Write features of pixels, ``rows`` ``(M, C)`` of three ``parents`` each, both ``(H W, 3)``, into an image.

    Args:
        side: pixels repeated at both ends.
        out: ``(H, W + 2 side, C)``.
    """
    height, width, channels = out.shape
    width -= 2 * side
    row = np.empty((width, channels), np.float32)
    for i in range(height):
        for j in range(width):
            pixel = i * width + j
            a, b, c = parents[pixel, 0], parents[pixel, 1], parents[pixel, 2]
            u, v, w = weights[pixel, 0], weights[pixel, 1], weights[pixel, 2]
            for k in range(channels):
                row[j, k] = u * rows[a, k] + v * rows[b, k] + w * rows[c, k]
        put(row.ravel(), out[i, side : side + width].ravel())
        out[i, :side] = out[i, width : width + side]
        out[i, side + width :] = out[i, side : 2 * side]


@njit(cache=True)
def _neighbours(own: F32, where: F32, here: F32, groups: I64, place: F32, scale: np.float32) -> F32:
    """Return the first convolution's outputs ``(M 16, h)``, rectified: ``own`` ``(N, h)`` of each neighbour, and its place's."""
    members, outputs = groups.shape[1], own.shape[1]
    out = np.empty((len(groups) * members, outputs), np.float32)
    zero, far = np.float32(0.0), np.float32(4.0)
    for i in range(len(groups)):
        x, y, z = here[i, 0], here[i, 1], here[i, 2]
        for j in range(members):
            n = groups[i, j]
            dx = min(max((where[n, 0] - x) / scale, -far), far)
            dy = min(max((where[n, 1] - y) / scale, -far), far)
            dz = min(max((where[n, 2] - z) / scale, -far), far)
            for k in range(outputs):
                value = own[n, k] + place[0, k] * dx + place[1, k] * dy + place[2, k] * dz
                out[i * members + j, k] = max(value, zero)
    return out


@njit(cache=True)
def _largest(rows: F32, shift: F32, members: int) -> F32:
    """Return the largest of every ``members`` rows ``(M members, o)``, shifted, then rectified."""
    count, outputs = len(rows) // members, rows.shape[1]
    out = np.empty((count, outputs), np.float32)
    for i in range(count):
        for k in range(outputs):
            out[i, k] = rows[i * members, k]
        for j in range(1, members):
            for k in range(outputs):
                out[i, k] = max(out[i, k], rows[i * members + j, k])
        for k in range(outputs):
            out[i, k] = max(out[i, k] + shift[k], np.float32(0.0))
    return out
