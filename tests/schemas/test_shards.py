"""Shards: sweeps survive the trip to Arrow bit for bit, and strangers are refused."""

from dataclasses import fields, replace

import numpy as np
import pyarrow as pa
import pytest

from salpcc.schemas.errors import ShardError
from salpcc.schemas.shards import KEPT, facts_of, stamp, sweeps_to_table, table_to_sweeps
from salpcc.schemas.sweep import Sweep

WEIRD = np.array([0x7FC00001, 0xFF800000, 0x80000000, 1], np.uint32).view(
    np.float32
)  # NaN, -inf, -0, denormal


def a_sweep(name: str, returns: int = 3, strays: int = 1) -> Sweep:
    rng = np.random.default_rng(returns)
    return Sweep(
        name=name, time=2**64 - 5, frame_id="os1/lidar", n_points=returns + strays + 2,
        motion=rng.normal(size=6), step=1, max_error=0.0,
        laser=rng.integers(0, 64, returns).astype(np.uint8),
        tick=rng.integers(0, 4000, returns).astype(np.int32),
        count=rng.integers(0, 60000, returns).astype(np.int32),
        intensity=np.resize(WEIRD, returns),
        millimetre=np.full(returns, 13, np.uint8), ulp=np.full(returns, 13, np.uint8),
        classes=np.full(returns, 9, np.uint8),
        stray_index=np.arange(strays, dtype=np.int64),
        stray_points=np.resize(WEIRD, (strays, 4)),
        stray_classes=np.zeros(strays, np.uint8),
    )  # fmt: skip


def same(a: Sweep, b: Sweep) -> bool:
    for field in fields(Sweep):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            if not isinstance(y, np.ndarray) or x.dtype != y.dtype or x.shape != y.shape:
                return False
            if x.tobytes() != y.tobytes():
                return False
        elif x != y:
            return False
    return True


def test_sweeps_come_back_bit_for_bit() -> None:
    sweeps = [
        a_sweep("000000", 4, 2),
        replace(a_sweep("000001", 2, 0), motion=None, classes=None, stray_classes=None),
        a_sweep("000002", 0, 0),
    ]
    back = table_to_sweeps(sweeps_to_table(sweeps))
    assert [same(a, b) for a, b in zip(sweeps, back, strict=True)] == [True] * 3


def test_no_sweeps_are_a_table_of_no_rows() -> None:
    assert table_to_sweeps(sweeps_to_table([], [])) == []


def test_task_table_carries_what_was_dropped() -> None:
    dropped = np.array([KEPT, 1, KEPT, 6], np.uint8)
    table = sweeps_to_table([a_sweep("0"), a_sweep("1")], [dropped, None])
    assert table.column("dropped_movable").to_pylist() == [2, 0]
    assert table.column("dropped_classes").to_pylist() == [dropped.tolist(), None]


def test_facts_come_back() -> None:
    table = stamp(pa.table({"a": [1]}), stage="segment", errors=[{"scan": "x"}])
    facts = facts_of(table.schema)
    assert facts["stage"] == "segment" and facts["errors"] == [{"scan": "x"}]


@pytest.mark.parametrize("version", ["2.0", "9.1"])
def test_newer_major_version_is_refused(version: str) -> None:
    table = stamp(pa.table({"a": [1]})).replace_schema_metadata({b"salpcc": f'{{"version": "{version}"}}'})
    with pytest.raises(ShardError, match="newer"):
        facts_of(table.schema)


def test_newer_minor_version_is_read() -> None:
    table = pa.table({"a": [1]}).replace_schema_metadata({b"salpcc": '{"version": "1.99", "later": 1}'})
    assert facts_of(table.schema)["later"] == 1


@pytest.mark.parametrize("metadata", [None, {b"other": b"1"}, {b"salpcc": b"no json"}, {b"salpcc": b"[]"}])
def test_stranger_is_refused(metadata: dict[bytes, bytes] | None) -> None:
    with pytest.raises(ShardError, match="not a shard"):
        facts_of(pa.table({"a": [1]}).replace_schema_metadata(metadata).schema)
