"""Errors of what a baseline gives back: point by point where it keeps the order, else to the nearest point."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from salpcc.stages.evaluate.baselines.baseline import Points
from salpcc.stages.evaluate.measures.metrics import point_errors, same_bits

_BATCH = 256
Columns = dict[str, Any]  # of a BASELINES row


def errors_in_order(source: Points, decoded: Points) -> Columns:
    """Compare ``(N, 3)`` points pair by pair; only D_d looks for neighbours."""
    source, decoded = np.ascontiguousarray(source), np.ascontiguousarray(decoded)
    errors = point_errors(source, decoded)
    return {
        "max_error_m": errors.maximum,
        "max_axis_error_m": errors.max_axis,
        "squared_error_m2": errors.sum_of_squares,
        "d_d_m2": 0.0 if same_bits(source, decoded) else _mean_square(*_both_ways(source, decoded)[:2]),
    }


def errors_nearest(source: Points, decoded: Points) -> Columns:
    """Nearest-neighbour errors, the worse of both ways: all that can be said once the order is gone."""
    there, back, of_source, of_decoded = _both_ways(source, decoded)
    axis = max(
        _max_axis(source, decoded, *there, of_decoded),
        _max_axis(decoded, source, *back, of_source),
    )
    return {
        "max_error_m": float(max(there[0].max(initial=0.0), back[0].max(initial=0.0))),
        "max_axis_error_m": axis,
        "squared_error_m2": float(np.square(back[0]).sum()),  # over points_decoded
        "d_d_m2": _mean_square(there, back),
    }


Found = tuple[NDArray[np.float64], NDArray[np.intp]]  # distances, and which neighbour


def _both_ways(source: Points, decoded: Points) -> tuple[Found, Found, cKDTree, cKDTree]:
    of_source, of_decoded = _tree(source.astype(np.float64).tobytes()), _grow(decoded)
    return _find(of_decoded, source), _find(of_source, decoded), of_source, of_decoded


def _find(tree: cKDTree, points: NDArray[Any], p: float = 2.0) -> Found:
    distance, which = tree.query(points, p=p)
    return np.asarray(distance), np.asarray(which)


def _mean_square(there: Found, back: Found) -> float:
    return float(np.square(there[0]).mean() / 2 + np.square(back[0]).mean() / 2)


@lru_cache(maxsize=8)
def _tree(points: bytes) -> cKDTree:
    """Grow the tree of a source scan once for all the codecs and errors that follow."""
    return _grow(np.frombuffer(points).reshape(-1, 3))


def _grow(points: NDArray[Any]) -> cKDTree:
    return cKDTree(points.astype(np.float64), balanced_tree=False)


def _max_axis(
    points: Points, others: Points, distance: NDArray[np.float64], which: NDArray[np.intp], tree: cKDTree
) -> float:
    """Largest distance to the nearest point when the distance is that of the worst axis.

    The nearest point in 3-D bounds it from above, so only the points with the largest bounds are searched.
    """
    bound = np.abs(points.astype(np.float64) - others[which].astype(np.float64)).max(axis=1)
    worst, order = 0.0, np.argsort(-bound)
    for start in range(0, len(order), _BATCH):
        some = order[start : start + _BATCH]
        if bound[some[0]] <= worst:
            break
        worst = max(worst, float(_find(tree, points[some], np.inf)[0].max()))
    return worst
