"""The mixture against the plain formula; every target is found in the level that holds it."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from salpcc.stages.predict.learned.mixture import (
    LOGISTIC,
    PLACES,
    SCALES,
    TOTAL,
    WEIGHTS,
    find_levels,
    level_ends,
    output_places,
    set_mixture,
)
from salpcc.stages.predict.learned.network import NEVER

SHIFT = 17


@njit(error_model="numpy")
def ends(
    sums: Any, shift: int, mu: Any, components: int, level: int, step: int, levels: int
) -> tuple[int, int]:
    mixture, whole, parts = np.zeros((2, 3 * PLACES)), np.zeros(2 * PLACES, np.int32), np.zeros(2 * PLACES)
    kept = set_mixture(sums, 1, shift, mu, 1, components, mixture, whole)
    return level_ends(mixture, 1, kept, level, step, levels, whole, parts)


@njit(error_model="numpy")
def find(sums: Any, shift: int, mu: Any, components: int, targets: Any, step: int, levels: int) -> Any:
    """Find several targets of one mixture, set once for each; level and ends ``(3, targets)``."""
    n = len(targets)
    mixture, whole, parts = (
        np.zeros((2 + n, 3 * PLACES)),
        np.zeros(2 * PLACES, np.int32),
        np.zeros(2 * PLACES),
    )
    kept, search = np.zeros(2 + n, np.int64), np.zeros((7, n), np.int64)
    for p in range(n):
        mu[2 + p] = mu[1]
        search[0, p] = targets[p]
        kept[2 + p] = set_mixture(sums, 1, shift, mu, 2 + p, components, mixture, whole)
    find_levels(mixture, 2, n, kept, step, levels, search, whole, parts)
    return search[1:4]


def plain_start(out: np.ndarray, mu: np.ndarray, level: int, step: int, levels: int) -> int:
    """Where a level starts, component by component; ``out`` are logits, offsets and log scales."""
    if level <= 0:
        return 0
    if level >= levels:
        return TOTAL
    n = len(out) // 3
    kept, total = [], 0.0
    for c in range(n):
        depth = float(out[:n].max() - out[c])
        if depth >= 9:
            continue
        weight = WEIGHTS[int(depth * 32)]
        s = int((min(max(out[2 * n + c] + 2.0, -2.0), 9.0) + 2.0) * 32)
        offset = min(max(out[n + c], -8.0), 8.0)
        kept.append((weight, float(mu[c]) + offset * SCALES[s, 0], SCALES[s, 1]))
        total += weight
    f, x = 0.0, level * step - 0.5
    for weight, mean, inverse in kept:
        z = (min(max((x - mean) * inverse, -17.0), 17.0) + 17.0) * 64.0
        k = int(z)
        f += weight / total * (LOGISTIC[k, 0] + (z - k) * (LOGISTIC[k + 1, 0] - LOGISTIC[k, 0]))
    return level + int(min(f, 1.0) * (TOTAL - levels))


@pytest.mark.parametrize("predictors", [10, 13])
@pytest.mark.parametrize("step", [1, 7])
@pytest.mark.parametrize("spread", [0.5, 3.0, 60.0])
def test_levels_lie_where_the_formula_says(predictors: int, step: int, spread: float) -> None:
    components, levels = predictors + 2, 30000
    rng = np.random.default_rng(predictors)
    for _ in range(40):
        out = rng.normal(0, spread, 3 * components)
        whole = np.rint(out * 2**SHIFT).astype(np.int32)
        sums = np.full((2, 3 * PLACES), NEVER, np.int32)
        sums[1, list(output_places(predictors))] = whole
        mu = np.zeros((30, PLACES), np.float32)
        mu[1, :components] = rng.uniform(0, levels * step) + rng.normal(0, 50, components)
        given = (sums, SHIFT, mu, components)
        centre = int(mu[1, 0] / step)
        for level in (0, 1, centre - 9, centre, centre + 1, centre + 300, levels - 1):
            level = min(max(level, 0), levels - 1)
            low, high = (plain_start(whole / 2**SHIFT, mu[1], v, step, levels) for v in (level, level + 1))
            assert ends(*given, level, step, levels) == (low, high)
            found = find(*given, np.array([low, (low + high) // 2, high - 1]), step, levels)
            assert (found == np.array([[level], [low], [high]])).all()
        targets = rng.integers(0, TOTAL, 20)
        for target, (level, low, high) in zip(targets, find(*given, targets, step, levels).T, strict=True):
            assert low <= target < high
            assert ends(*given, level, step, levels) == (low, high)
