"""Selecting baselines, and what happens when one is missing or breaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate import baselines
from salpcc.stages.evaluate.baselines import names
from salpcc.stages.evaluate.baselines.baseline import Points
from salpcc.stages.evaluate.baselines.measure_baseline import measure


def test_selections() -> None:
    assert names("all") == tuple(baselines.BASELINES)
    assert names("none") == ()
    assert names("xz, octree,xz") == ("xz", "octree")
    with pytest.raises(UsageError, match="no baseline mp3; choose from"):
        names("xz,mp3")


def test_a_missing_package_costs_a_row_only(street: Callable[..., Scan]) -> None:
    absent = replace(baselines.BASELINES["xz"], packages=("no_such_package",))
    (row,) = measure("xz", absent, [street()], "00", 0.0)
    assert row["status"] == "not run: no_such_package not installed, pip install no_such_package"
    assert "bytes_geometry" not in row


def test_a_codec_that_breaks_costs_its_rows_only(street: Callable[..., Scan]) -> None:
    def broken(points: Points, max_error: float) -> bytes:
        raise ZeroDivisionError("no luck\nand more")

    bad = replace(baselines.BASELINES["xz"], encode=broken)
    rows = measure("bad", bad, [street(), street()], "00", 0.0)
    assert [row["status"] for row in rows] == ["failed: no luck"] * 2
