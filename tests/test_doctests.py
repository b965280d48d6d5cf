"""Every example in a docstring says what it gives."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import salpcc

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for room in ("schemas", "stages", "pipeline")
    for path in (ROOT / room).rglob("*.py")
    if ">>> " in path.read_text()
)


@pytest.mark.parametrize("module", MODULES)
def test_examples(module: str, tmp_path: Path) -> None:
    """An example finds an empty ``folder`` to write to."""
    imported = importlib.import_module(f"salpcc.{module}")
    done = doctest.testmod(imported, optionflags=doctest.ELLIPSIS, extraglobs={"folder": tmp_path})
    assert done.attempted > 0 and done.failed == 0


def test_whatever_is_public_has_one() -> None:
    public = [getattr(salpcc, name) for name in salpcc.__all__ if not name.startswith("_")]
    assert [what.__name__ for what in public if ">>> " not in what.__doc__] == []
