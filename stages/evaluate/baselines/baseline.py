"""The contract of a baseline.

``encode(points, max_error) -> bytes`` and ``decode(data) -> points`` are pure functions. A codec that predicts
one scan from another has a :class:`Group` too, the same for consecutive scans: one piece of data per scan,
which decode together only. ``points`` is
``(N, 3)`` float32 x, y, z in metres, or ``(N, 4)`` with the intensity as fourth column where the codec
carries one; ``decode`` needs nothing but the bytes and gives as many columns back. ``max_error`` is in
metres and 0 asks for bit-exactness. All bytes that a decoder needs are in the data: quantisation origin,
counts, tables. What a codec cannot do it refuses with :class:`NotPossible`; it never degrades silently.

What a codec promises is a :class:`Promise`, and ``tests/stages/evaluate/baselines/test_contract.py`` holds
every codec to its own. Codecs import their packages inside the functions, so that a missing one costs a row
of the report and nothing else.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError

Points = NDArray[np.float32]

# Codecs that quantise do so in float32, which adds a little to the half step that they promise.
FLOAT32_SLACK = 2e-5  # metres


class NotPossible(SalpccError):
    """The codec cannot do what is asked (bit-exact where it quantises, a range beyond its 16 bits, …)."""


@dataclass(frozen=True)
class Promise:
    """What a codec guarantees.

    Attributes:
        bound: ``exact``: bit for bit, asked with error 0 only. ``axis``: no coordinate is off by more than
            the asked error (and FLOAT32_SLACK). ``none``: the asked error steers it but bounds nothing.
        order: points come back in file order.
        count: as many points come back as went in.
        intensity: a fourth column is carried, bit-exact.
    """

    bound: Literal["exact", "axis", "distance", "none"]
    order: bool
    count: bool
    intensity: bool


@dataclass(frozen=True)
class Group:
    """How a codec takes consecutive scans together: at most ``size`` of them, each with its own bytes."""

    size: int
    encode: Callable[[Sequence[Points], float], list[bytes]]
    decode: Callable[[Sequence[bytes]], list[Points]]


@dataclass(frozen=True)
class Baseline:
    """One codec: what it is called, what it needs, what it promises, and its two functions."""

    title: str
    packages: tuple[
        str, ...
    ]  # beyond the product's own dependencies, by the name that imports and installs them
    promise: Promise
    encode: Callable[[Points, float], bytes]
    decode: Callable[[bytes], Points]
    program: str | None = None  # that must be on the PATH
    group: Group | None = None  # where scans are predicted from each other
    geometry: Callable[[bytes], int] | None = None  # bytes of its data that are geometry, where they tell
    own_seconds: Callable[[], float | None] | None = (
        None  # CPU time of its last call, where its program tells
    )

    def together(self) -> Group:
        """Give the codec as one of groups; one that knows single scans takes them one at a time."""
        if self.group is not None:
            return self.group
        return Group(
            1,
            lambda scans, max_error: [self.encode(points, max_error) for points in scans],
            lambda data: [self.decode(piece) for piece in data],
        )

    def missing(self) -> str | None:
        """Say what it lacks on this machine, or None where it can run."""
        if self.program is not None and find_program(self.program) is None:
            return f"{self.program} not found"
        absent = [package for package in self.packages if find_spec(package) is None]
        if absent:
            return f"{', '.join(absent)} not installed, pip install {' '.join(absent)}"
        return None


def find_program(name: str) -> str | None:
    """Return the path of a program: what ``SALPCC_NAME`` in the environment says, else what is on the PATH."""
    return shutil.which(os.environ.get(f"SALPCC_{name.upper()}") or name)


def quantize(points: NDArray[Any], step: float) -> NDArray[np.int64]:
    """Round coordinates to multiples of ``step``: ``(N, 3)`` int64. Inverse: :func:`dequantize`.

    Raises:
        NotPossible: a coordinate is not finite.
    """
    if not np.isfinite(points).all():
        raise NotPossible("points that are not finite cannot be quantised")
    return np.rint(points.astype(np.float64) / step).astype(np.int64)


def dequantize(levels: NDArray[Any], step: float) -> Points:
    """Return the float32 coordinates of levels; inverse of :func:`quantize`."""
    return (levels.astype(np.float64) * step).astype(np.float32)


def step_of(max_error: float) -> float:
    """Return the step whose half is the asked error.

    Raises:
        NotPossible: the asked error is 0.
    """
    if max_error <= 0:
        raise NotPossible("this codec quantises: it needs an error above 0")
    return 2.0 * max_error
