"""Numbers by mixtures of guesses: any number comes back, a good guess is cheap, and trust follows who is right."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from salpcc.stages.entropy.mixed_numbers import (
    NODES,
    Guesses,
    code_mixed_number,
    learn_trust,
    new_guesses,
    new_numbers,
    weigh,
)
from salpcc.stages.entropy.walks import finish_coder, start_coder


def walk(
    writing: bool, values: np.ndarray, means: np.ndarray, per: float, buffer: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray]:
    """Code values ``(n,)`` by guesses ``(n, g)``; they, the bytes written, and the trust at last."""
    n, most = means.shape
    state, numbers = start_coder(writing, buffer), new_numbers(4, 2, 2)
    guesses, trust, opinions = new_guesses(most), np.ones((1, most)), np.zeros(2)
    out = values.copy()
    for i in range(n):
        for j in range(most):
            guesses.mean[j], guesses.per[j], guesses.weight[j] = means[i, j], per, trust[0, j]
        centre = weigh(guesses, most, 0.0)
        places = np.array([i % 2, 2 + i % 2]) * NODES
        out[i] = code_mixed_number(
            writing, state, buffer, int(out[i]), centre, guesses, most, numbers, places, i % 2, opinions
        )
        learn_trust(int(out[i]), guesses, most, trust, 0)
    return out, finish_coder(writing, state, buffer), trust


def coded(values: np.ndarray, means: np.ndarray, per: float = 0.5) -> tuple[int, np.ndarray]:
    """Bytes that values take, which must come back, and the trust at last."""
    out = np.zeros(40 * len(values) + 64, np.uint8)
    _, size, trust = walk(True, values, means, per, out)
    assert size >= 0  # trailing zeros are not kept
    back, ended, _ = walk(False, np.zeros_like(values), means, per, out[:size].copy())
    assert ended == 0
    assert back.tolist() == values.tolist()
    return size, trust


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(-(1 << 37), 1 << 37), st.floats(-1e9, 1e9), st.floats(-50, 50)),
        min_size=1,
        max_size=30,
    ),
    st.sampled_from([1e-9, 0.01, 1.0, 4.0]),
)
def test_any_number_comes_back(given: list[tuple[int, float, float]], per: float) -> None:
    values = np.array([value for value, _, _ in given])
    coded(values, np.array([means for _, *means in given]), per)


def test_costs_what_the_better_guess_says() -> None:
    rng = np.random.default_rng(0)
    means = rng.uniform(-1000, 1000, (4000, 2))
    which = rng.random(4000) < 0.9
    values = np.rint(np.where(which, means[:, 0], means[:, 1]) + rng.normal(0, 0.3, 4000)).astype(np.int64)
    size, trust = coded(values, means, 4.0)
    assert 8 * size < 2.6 * len(values)
    assert trust[0, 0] > 4 * trust[0, 1]


def test_the_centre_is_where_the_mixture_is_densest() -> None:
    guesses = Guesses(
        np.array([3.0, 8.0, 9.0]), np.array([0.1, 2.0, 1.0]), np.array([5.0, 1.0, 1.0]), np.zeros(3)
    )
    assert weigh(guesses, 3, 0.0) == 8.0
    assert abs(guesses.weight.sum() - 1.0) < 1e-4
    assert weigh(guesses, 0, 7.0) == 7.0
