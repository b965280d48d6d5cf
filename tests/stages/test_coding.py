"""One table of stages: what is in it, and that all who run stages go by it."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.config import RunConfig
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import STAGES as NAMES
from salpcc.stages import coding


def test_the_command_line_names_the_same_stages() -> None:
    assert (*coding.STAGES, "evaluate") == NAMES


def test_every_stage_takes_what_is_made_before_it() -> None:
    made: set[str] = set()
    for stage in coding.STAGES.values():
        assert set(stage.inputs) <= made and stage.version > 0
        made.add(stage.name)


def test_tables_have_their_schemas() -> None:
    scan = Scan("0", np.ones((5, 3), np.float32), np.zeros(5, np.float32))
    made = coding.code([(0, scan)], RunConfig(keep_movable=True, effort="fast"))
    for name, table in made.items():
        assert table.schema.equals(coding.STAGES[name].schema), name


def test_one_more_stage_is_one_more_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A toy one that looks at every payload runs wherever groups are coded."""
    seen: list[int] = []
    toy = coding.Stage(
        "count",
        1,
        lambda coded, config: seen.append(coded.num_rows) or coded,
        ("residual_code",),
        coding.PAYLOAD,
    )
    monkeypatch.setitem(coding.STAGES, "count", toy)
    scan = Scan("0", np.ones((5, 3), np.float32), np.zeros(5, np.float32))
    config = RunConfig(keep_movable=True, effort="fast")
    assert coding.code([(0, scan), (1, replace(scan, name="1"))], config, last="count")["count"].num_rows == 2
    assert seen == [2]
