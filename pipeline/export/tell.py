"""How what writes files says what they do not hold; the command line prints it, others may pass it by."""

from __future__ import annotations

from collections.abc import Callable

Tell = Callable[[str], object]


def in_silence(_: str) -> None:
    """Tell nobody."""
