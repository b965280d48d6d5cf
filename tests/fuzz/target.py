"""What is fuzzed: a reader, whole inputs for it, and what it may make of damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mutate import mutate

Mutator = Callable[[bytes, np.random.Generator], bytes]


class Wrong(Exception):
    """A reader gave back something else than what was written, without a word."""


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        inputs: whole inputs, as the files of a folder that is empty before.
        read: read one of them, damaged; raises SalpccError where it refuses, Wrong where it should have.
        share: of all mutations.
        mutate: how they are made.
    """

    inputs: Callable[[Path], list[bytes]]
    read: Callable[[int, bytes, Path], object]
    share: float
    mutate: Mutator = mutate
