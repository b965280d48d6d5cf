"""The page of bench table comes from the bench's own figures, between markers, and nothing else changes."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from salpcc.stages.evaluate.studies import bench


@pytest.fixture
def measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bench of two codecs, as ``--json`` writes it."""
    path = tmp_path / "bench.json"
    row = {"max_error": 0.01, "bpp_geometry": 3.25, "bpp_total": 7.5, "bit_exact": False}
    row |= {"encode_ms": 12.4, "decode_ms": 9.0}
    rows = [row | {"codec": "ours", "max_error_m": 0.0098}, row | {"codec": "draco", "max_error_m": None}]
    document = bench._document(["--scans", "0", "--json", str(path)], [], 5, rows)
    path.write_text(json.dumps(document))
    return path


def test_the_block_is_filled_and_the_rest_stays(script: ModuleType, measured: Path, tmp_path: Path) -> None:
    page = tmp_path / "figures.md"
    page.write_text("# Title\n<!-- figures:begin bench -->\nold 9.99\n<!-- figures:end -->\nend\n")
    arguments = ["--bench", str(measured), "--page", str(page)]
    assert script.main([*arguments, "--check"]) == 1
    assert script.main(arguments) == 0
    text = page.read_text()
    assert text.startswith("# Title\n<!-- figures:begin bench -->\n") and text.endswith(
        "<!-- figures:end -->\nend\n"
    )
    assert "| 10 mm | ours | 3.25 | 7.50 | 9.800 | 12 | 9 |" in text
    assert "| 10 mm | draco | 3.25 | 7.50 | - | 12 | 9 |" in text
    assert "9.99" not in text and "evaluate.studies.bench --scans 0`" in text
    assert script.main([*arguments, "--check"]) == 0


def test_without_a_block_nothing_is_written(script: ModuleType, measured: Path, tmp_path: Path) -> None:
    page = tmp_path / "figures.md"
    page.write_text("no markers")
    assert script.main(["--bench", str(measured), "--page", str(page)]) == 2
    assert page.read_text() == "no markers"
