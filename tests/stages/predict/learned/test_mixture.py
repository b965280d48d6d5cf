"""The mixture against the plain formula; every target is found in the level that holds it."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from salpcc.stages.predict.learned.mixture import (
    PLACES,
    SIZE,
    TOTAL,
    find_levels,
    level_ends,
    output_places,
    set_mixture,
)
from salpcc.stages.predict.learned.network import NEVER

SHIFT = 17
F = np.float32


@njit(error_model="numpy")
def ends(sums: Any, shift: int, mu: Any, level: int, step: int, levels: int) -> tuple[int, int]:
    mixture = np.zeros((2, SIZE), np.float32)
    set_mixture(sums, 1, shift, mu, 1, levels, mixture)
    return level_ends(mixture, 1, level, step, levels)


@njit(error_model="numpy")
def find(sums: Any, shift: int, mu: Any, targets: Any, step: int, levels: int) -> Any:
    """Find several targets of one mixture, set once for each; level and ends ``(3, targets)``."""
    n = len(targets)
    mixture, search = np.zeros((2 + n, SIZE), np.float32), np.zeros((7, n), np.int64)
    for p in range(n):
        mu[2 + p] = mu[1]
        search[0, p] = targets[p]
        set_mixture(sums, 1, shift, mu, 2 + p, levels, mixture)
    find_levels(mixture, 2, n, step, levels, search)
    return search[1:4]


def power(x: np.float32, doublings: int) -> np.float32:
    for _ in range(doublings):
        x = F(x * x)
    return x


def added(values: list[np.float32]) -> np.float32:
    """The sum of PLACES numbers, the upper half added to the lower one again and again."""
    while len(values) > 1:
        half = len(values) // 2
        values = [F(values[n] + values[half + n]) for n in range(half)]
    return values[0]


def plain_start(out: np.ndarray, mu: np.ndarray, level: int, step: int, levels: int) -> int:
    """Where a level starts, component by component; ``out`` are logits, offsets and log scales."""
    if level <= 0:
        return 0
    if level >= levels:
        return TOTAL
    n, none = len(out) // 3, [F(0)] * PLACES
    weights, shares = list(none), list(none)
    x = F(F(level * step) - F(0.5))
    for c in range(n):
        weights[c] = power(max(F(1) - F(out[:n].max() - out[c]) * F(1 / 256), F(0)), 8)
    share = F(TOTAL - levels) / added(weights)
    for c in range(n):
        log_scale = min(max(F(F(out[2 * n + c]) + F(2)), F(-2)), F(9))
        inverse = power(F(1) - log_scale * F(1 / 4096), 12)
        mean = F(mu[c]) + min(max(F(out[n + c]), F(-8)), F(8)) / inverse
        z = min(max((x - mean) * inverse * F(1 / 256), F(-17 / 256)), F(17 / 256))
        shares[c] = weights[c] * share * (F(1) - F(1) / (power(z + F(1), 8) + F(1)))
    return level + min(int(added(shares)), TOTAL - levels)


def true_share(out: np.ndarray, mu: np.ndarray, x: float) -> float:
    """The mixture's distribution function, by the library's exponential."""
    n = len(out) // 3
    weight = np.exp(out[:n] - out[:n].max())
    scale = np.exp(np.clip(out[2 * n :] + 2, -2, 9))
    z = (x - mu[:n] - np.clip(out[n : 2 * n], -8, 8) * scale) / scale
    return float((weight / weight.sum() / (1 + np.exp(-np.clip(z, -40, 40)))).sum())


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
        given = (sums, SHIFT, mu)
        centre = int(mu[1, 0] / step)
        for level in (0, 1, centre - 9, centre, centre + 1, centre + 300, levels - 1):
            level = min(max(level, 0), levels - 1)
            low, high = (plain_start(whole / 2**SHIFT, mu[1], v, step, levels) for v in (level, level + 1))
            assert ends(*given, level, step, levels) == (low, high)
            if level > 0:
                assert abs(low / TOTAL - true_share(whole / 2**SHIFT, mu[1], level * step - 0.5)) < 0.02
            found = find(*given, np.array([low, (low + high) // 2, high - 1]), step, levels)
            assert (found == np.array([[level], [low], [high]])).all()
        targets = rng.integers(0, TOTAL, 20)
        for target, (level, low, high) in zip(targets, find(*given, targets, step, levels).T, strict=True):
            assert low <= target < high
            assert ends(*given, level, step, levels) == (low, high)


@pytest.mark.parametrize("spread", [0.5, 3.0, 60.0])
def test_no_level_is_empty(spread: float) -> None:
    levels, rng = 3000, np.random.default_rng(3)
    for _ in range(5):
        sums = rng.normal(0, spread * 2**SHIFT, (2, SIZE)).astype(np.int32)
        mu = rng.uniform(0, levels, (2, PLACES)).astype(np.float32)
        at = 0
        for level in range(levels):
            low, high = ends(sums, SHIFT, mu, level, 1, levels)
            assert low == at < high
            at = high
        assert at == TOTAL
