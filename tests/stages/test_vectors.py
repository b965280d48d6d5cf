"""Vectors in compiled code do what their NumPy twins do, lane by lane and bit by bit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba import njit

from salpcc.stages import vectors
from salpcc.stages.vectors import (
    bits,
    cast,
    choose,
    count,
    dot,
    highest,
    join,
    lane,
    larger,
    load,
    of,
    pairs,
    pick,
    prefetch,
    push,
    root,
    running,
    size,
    smaller,
    splice,
    spread,
    store,
    totals,
    whole,
)

HALF, THREE = np.float32(0.5), np.int32(3)


def plain(a: Any, b: Any, out: Any) -> None:
    """Arithmetic on whole arrays of 16 floats."""
    x, y = load(a, 0, 16), load(b, 0, 16)
    store(out, 0, x + y)
    store(out, 16, x - y)
    store(out, 32, x * y)
    store(out, 48, x / y)
    store(out, 64, x * HALF)
    store(out, 80, HALF / x)
    store(out, 96, smaller(x, y))
    store(out, 112, larger(x, y))
    store(out, 128, larger(smaller(x, HALF), -HALF))
    store(out, 144, root(size(x)))
    store(out, 160, whole(x))
    store(out, 176, choose(x < y, x, y))
    store(out, 192, choose(x > HALF, y, spread(HALF, 16)))


def order(a: Any, b: Any, out: Any) -> None:
    """Lanes that move."""
    x, y = load(a, 0, 8), load(b, 0, 8)
    store(out, 0, join(x, y))
    store(out, 16, splice(x, y, 3))
    store(out, 24, pick(x, 7, 0, 0, 5))
    store(out, 28, push(x, lane(y, 2)))
    store(out, 36, of(lane(x, 1), HALF, lane(y, 7), lane(y, 0)))
    out[40] = count(x < y)
    out[41] = count(x > y)
    out[42] = count(x >= splice(x, y, 3))
    store(out, 43, totals(x))
    store(out, 44, totals(x, y, x * y))
    store(out, 47, totals(join(x, y), join(y, x)))


def integers(a: Any, b: Any, out: Any) -> None:
    """Whole numbers of 32 bits."""
    x, y = load(a, 0, 16), load(b, 0, 16)
    store(out, 0, x + y)
    store(out, 16, x - y)
    store(out, 32, (x * y) >> THREE)
    store(out, 48, smaller(x, y))
    store(out, 64, larger(x, THREE))
    store(out, 80, running(x))
    out[96] = highest(x)
    out[97] = count(x < y)


def products(a: Any, b: Any, out: Any) -> None:
    """Pairs of whole numbers of 16 bits."""
    x = load(a, 0, 32)
    store(out, 0, dot(x, load(b, 0, 32)))
    store(out, 16, dot(x, pairs(b, 6, 32)))


def numbers(a: Any, b: Any, out: Any) -> None:
    """One type from another."""
    x = cast(load(a, 0, 16), np.int32)
    store(out, 0, x)
    store(out, 16, cast(cast(x, np.float32) * HALF, np.int32))
    store(out, 32, cast(cast(x, np.int16), np.int32))
    store(out, 48, cast(cast(x, np.float64), np.int32))
    store(out, 64, bits(load(a, 0, 16)))
    prefetch(a, 3)


def reals(rng: np.random.Generator) -> Any:
    return rng.normal(0, 30, 16).astype(np.float32)


def wide(rng: np.random.Generator) -> Any:
    return rng.integers(-(2**14), 2**14, 16).astype(np.int32)


def small(rng: np.random.Generator) -> Any:
    return rng.integers(-(2**15) + 1, 2**15, 32).astype(np.int16)


@pytest.mark.parametrize(
    ("kernel", "values", "out"),
    [
        (plain, reals, np.zeros(208, np.float32)),
        (order, reals, np.zeros(49, np.float32)),
        (integers, wide, np.zeros(98, np.int32)),
        (products, small, np.zeros(32, np.int32)),
        (numbers, reals, np.zeros(80, np.int32)),
    ],
)
def test_compiled_lanes_equal_numpy(
    kernel: Callable[..., None], values: Callable[[np.random.Generator], Any], out: Any
) -> None:
    rng = np.random.default_rng(3)
    compiled = njit(error_model="numpy")(kernel)
    for _ in range(20):
        a, b = values(rng), values(rng)
        here, there = out.copy(), out.copy()
        kernel(a, b, here)
        compiled(a, b, there)
        assert here.tobytes() == there.tobytes()


def test_what_is_no_number_ends_up_within_bounds() -> None:
    """Damaged bytes may lead anywhere; what becomes an index afterwards must not."""

    @njit(error_model="numpy")
    def clipped(a: Any, out: Any) -> None:
        store(out, 0, cast(larger(smaller(load(a, 0, 4), HALF), -HALF), np.int32))

    out = np.full(4, 9, np.int32)
    clipped(np.array([np.nan, np.inf, -np.inf, 0.25], np.float32), out)
    assert (np.abs(out) <= 1).all()


def test_every_operation_is_tried_here() -> None:
    names = {name for name, value in vars(vectors).items() if callable(value) and name.islower()}
    own = {name for name in names if getattr(vectors, name).__module__ == vectors.__name__}
    assert {name for name in own if not name.startswith("_")} <= set(globals())
