"""Exponentials and logistic functions as powers: ``exp(y)`` is ``(1 + y / 256) ^ 256``, products of float32 lanes.

Rounded products and quotients of what grows grow, too, and they are the same on every machine.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.vectors import Lanes, inline, larger, smaller

_REACH = np.float32(17.0 / 256)
_PER_256, _ONE = np.float32(1.0 / 256), np.float32(1.0)


@inline
def to_the_256th(x: Lanes) -> Lanes:
    """Return the 256th power."""
    for _ in range(8):
        x = x * x
    return x


@inline
def above(z: Lanes) -> Lanes:
    """Return the share of a logistic distribution above ``z`` widths from its mean; flat beyond 17."""
    odds = to_the_256th(larger(smaller(z * _PER_256, _REACH), -_REACH) + _ONE)
    return _ONE / (odds + _ONE)
