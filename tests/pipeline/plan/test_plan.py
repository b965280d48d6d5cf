"""The plan: which scans, cut where."""

from collections.abc import Callable
from pathlib import Path

import pytest

from salpcc.pipeline.plan.plan import cut, plan_run, select
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.work import ScanRef

REFS = [ScanRef(f"{n:06d}", n, f"{n}.bin", 0) for n in (0, 1, 2, 5, 9)]


def test_gops_hold_every_scan_once_in_order() -> None:
    gops = cut("semantickitti", "04", REFS, 2)
    assert [[ref.number for ref in gop.scans] for gop in gops] == [[0, 1], [2, 5], [9]]
    assert [gop.number for gop in gops] == [0, 1, 2]


@pytest.mark.parametrize(
    ("frames", "numbers"), [(None, [0, 1, 2, 5, 9]), ((1, 5), [1, 2]), ((5, 6), [5]), ((6, 9), [])]
)
def test_frames_are_numbers_not_places(frames: tuple[int, int] | None, numbers: list[int]) -> None:
    assert [ref.number for ref in select(REFS, frames)] == numbers


def test_missing_root_says_where_data_come_from_and_how_to_try_without(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere not found.*cvlibs.*--source simulated") as caught:
        plan_run(tmp_path / "nowhere", ["00"], RunConfig())
    assert "\n" not in str(caught.value)


def test_a_missing_sequence_does_not_stop_the_others(toy_root: Path) -> None:
    plans, missing = plan_run(toy_root, ["00", "05"], RunConfig())
    assert [plan.sequence for plan in plans] == ["00"] and plans[0].n_scans == 5
    assert [error.sequence for error in missing] == ["05"]


def test_nothing_to_do_is_wrong_use(toy_root: Path) -> None:
    with pytest.raises(UsageError, match="sequences there: 00, 01"):
        plan_run(toy_root, ["05"], RunConfig())
    with pytest.raises(UsageError, match="no scans in the frames"):
        plan_run(toy_root, ["00"], RunConfig(frames=(100, 200)))


def test_an_output_among_the_files_of_a_sequence_is_refused(
    tmp_path: Path, toy: Callable[[Path, str, list[int]], Path]
) -> None:
    """A second run would take the files of the first one into its archive."""
    root = toy(tmp_path, "00", [0])
    inside = root / "sequences" / "00" / "runs" / "out"
    with pytest.raises(UsageError, match=r"out lies in .*00, .* choose another --out"):
        plan_run(root, ["00"], RunConfig(), inside)
    for out, config in ((root / "out", RunConfig()), (inside, RunConfig(side_files=False))):
        assert len(plan_run(root, ["00"], config, out)[0]) == 1
