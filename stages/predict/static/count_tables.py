"""The shipped tables of effort ``fast``, named in an archive by their digest."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError
from salpcc.stages.entropy.rans import TOTAL
from salpcc.stages.predict.static import intensities, levels
from salpcc.stages.predict.static.symbols import Starts, starts_of
from salpcc.stages.predict.static.tokens import TOKENS

WEIGHTS = Path(__file__).parent / "weights"
STEPS = (1, 2, 8, 15)  # levels of as many counts share tables from each of these on


def table_of(step: int) -> int:
    """Return which tables levels of ``step`` counts have."""
    return sum(step >= least for least in STEPS) - 1


@dataclass(frozen=True, eq=False)
class StaticTables:
    """Frequencies in 1/4096; the last symbol is the escape.

    Attributes:
        levels: ``(4, C, TOKENS)`` uint16, of the tokens of residuals.
        intensities: ``(C, 102)`` uint16.
    """

    levels: NDArray[np.uint16]
    intensities: NDArray[np.uint16]

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of the tables, whatever file they came from."""
        total = sha256()
        for name in ("levels", "intensities"):
            array = getattr(self, name)
            total.update(f"{name}{array.shape}".encode())
            total.update(array.astype("<i4").tobytes())
        return total.hexdigest()

    @cached_property
    def level_symbols(self) -> tuple[Starts, ...]:
        """The tables of residuals, laid out for the coder."""
        return tuple(starts_of(frequency) for frequency in self.levels)

    @cached_property
    def intensity_symbols(self) -> Starts:
        """The tables of intensities, laid out for the coder."""
        return starts_of(self.intensities)


def check(tables: StaticTables) -> None:
    """Raise ValueError where the coder could not use them; the escape makes sure that all has a code."""
    shapes = tables.levels.shape, tables.intensities.shape
    if shapes != (
        (len(STEPS), levels.CONTEXTS, TOKENS),
        (intensities.CONTEXTS, intensities.ESCAPE + 1),
    ):
        raise ValueError(f"shapes {shapes}")
    for frequency in (tables.levels, tables.intensities):
        sound = (frequency.sum(-1, dtype=np.int64) == TOTAL).all() and frequency[..., -1].min() > 0
        if not sound or frequency.max() >= TOTAL:
            raise ValueError("frequencies that cannot be")


def load_tables(path: Path) -> StaticTables:
    """Read tables written by :func:`save_tables`; raises SalpccError where they are damaged."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as stored:
            tables = StaticTables(stored["levels"].astype(np.uint16), stored["intensities"].astype(np.uint16))
        check(tables)
    except Exception as error:  # NumPy meets damaged bytes with whatever comes to hand
        raise SalpccError(f"{path}: not tables of the coder ({error})") from error
    return tables


def save_tables(path: Path, tables: StaticTables) -> None:
    """Write tables; inverse of :func:`load_tables`."""
    np.savez_compressed(path, levels=tables.levels, intensities=tables.intensities)


@cache
def shipped() -> StaticTables:
    """Load the tables that are shipped."""
    return load_tables(WEIGHTS / "fast.npz")
