"""The loop behind Fig. 8: what a coder takes is summed up, and one that does not give back says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.studies.coders import _on_scans, _sum
from salpcc.stages.residual_code.paper.lossless import CODERS


def refuse(data: bytes, size: int) -> bytes:
    raise ArchiveError("stream is damaged")


def test_coders_are_summed_up_over_the_scans(street: Callable[..., Scan]) -> None:
    coder, scans = CODERS["bzip2"], [street("0"), street("1", seed=1)]
    single = [_sum(_on_scans(coder, [scan]))["bytes_out"] for scan in scans]
    both = _sum(_on_scans(coder, scans))
    assert both["status"] == "ok" and both["bytes_out"] == sum(single) > 0 and both["encode_ms"] > 0


@pytest.mark.parametrize("decode", [refuse, lambda data, size: bytes(size)])
def test_a_coder_that_does_not_give_back_has_no_figures(
    decode: Callable[[bytes, int], bytes], street: Callable[..., Scan]
) -> None:
    found = _sum(_on_scans(replace(CODERS["bzip2"], decode=decode), [street()]))
    assert found["status"].startswith("failed: ") and "bytes_out" not in found
