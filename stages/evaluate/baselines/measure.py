"""Run one baseline on one scan at one asked error, and measure what comes back."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from scipy.spatial import cKDTree

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.contract import Baseline, Points
from salpcc.stages.evaluate.metrics import point_errors, same_bits, symmetric_distance
from salpcc.stages.evaluate.schema import BASELINES as BASELINES_SCHEMA

ERRORS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)  # metres; what users ask for, and a curve's worth of them

_T = TypeVar("_T")
_warm: set[str] = set()  # codecs that this process has run


def asked_errors(name: str) -> tuple[float, ...]:
    """Return the errors that a baseline is measured at; 0 is bit-exact."""
    bound = BASELINES[name].promise.bound
    return {"exact": (0.0,), "distance": (0.0, *ERRORS)}.get(bound, ERRORS)


def measure_scans(name: str, scans: Iterable[Scan], sequence: str) -> pa.Table:
    """Measure a baseline at each of its errors on each scan: a BASELINES table, good for one task of a run."""
    errors = asked_errors(name)
    rows = [measure(name, scan, sequence, error) for scan in scans for error in errors]
    return pa.Table.from_pylist(rows, schema=BASELINES_SCHEMA)


def measure(name: str, scan: Scan, sequence: str, max_error: float) -> dict[str, Any]:
    """Return one BASELINES row. Never raises for what the codec does: the row's status says it."""
    baseline = BASELINES[name]
    row: dict[str, Any] = {
        "baseline": name,
        "sequence": sequence,
        "name": scan.name,
        "max_error": max_error,
        "points_in": len(scan),
    }
    if missing := baseline.missing():
        return row | {"status": f"not run: {missing}"}
    try:
        _warm_up(name, scan, max_error)
        return row | _measure(baseline, scan, max_error) | {"status": "ok"}
    except Exception as error:  # noqa: BLE001  whatever a foreign codec throws costs its row and nothing else
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        return row | {"status": f"failed: {reason[:200]}"}


def _warm_up(name: str, scan: Scan, max_error: float) -> None:
    """Let imports and compilation happen once a process, outside the measured times, on the first scan."""
    if name in _warm:
        return
    _warm.add(name)
    baseline = BASELINES[name]
    with suppress(Exception):  # the measurement that follows will say what is wrong
        baseline.decode(baseline.encode(np.ascontiguousarray(scan.points), max_error))


def _measure(baseline: Baseline, scan: Scan, max_error: float) -> dict[str, Any]:
    """Encode and decode the geometry, and with intensity where the codec carries it; compare.

    Times are those of all that the codec carries.
    """
    points = np.ascontiguousarray(scan.points)
    data, encode_ms = _timed(lambda: baseline.encode(points, max_error))
    row: dict[str, Any] = {"bytes_geometry": len(data)}
    whole = points
    if baseline.promise.intensity:
        whole = np.column_stack([scan.points, scan.intensity])
        data, encode_ms = _timed(lambda: baseline.encode(whole, max_error))
        row["bytes_total"] = len(data)
    decoded, decode_ms = _timed(lambda: baseline.decode(data))
    row |= {"encode_ms": encode_ms, "decode_ms": decode_ms, "points_decoded": len(decoded)}
    in_order = baseline.promise.order and len(decoded) == len(points)
    row |= {"in_order": in_order, "bit_exact": same_bits(whole, decoded)}
    return row | (_errors_in_order if in_order else _errors_nearest)(points, decoded[:, :3])


def _errors_in_order(source: Points, decoded: Points) -> dict[str, Any]:
    decoded = np.ascontiguousarray(decoded)
    errors = point_errors(source, decoded)
    return {
        "max_error_m": errors.maximum,
        "max_axis_error_m": errors.max_axis,
        "squared_error_m2": errors.sum_of_squares,
        "d_d_m2": 0.0 if same_bits(source, decoded) else symmetric_distance(source, decoded),
    }


def _errors_nearest(source: Points, decoded: Points) -> dict[str, Any]:
    """Nearest-neighbour errors, the worse of both ways: all that can be said once the order is gone."""
    a, b = source.astype(np.float64), decoded.astype(np.float64)
    of_a, of_b = cKDTree(a), cKDTree(b)
    there, back = np.asarray(of_b.query(a)[0]), np.asarray(of_a.query(b)[0])
    axis = max(np.max(of_b.query(a, p=np.inf)[0]), np.max(of_a.query(b, p=np.inf)[0]))
    return {
        "max_error_m": float(max(there.max(), back.max())),
        "max_axis_error_m": float(axis),
        "squared_error_m2": float(np.square(back).sum()),  # over points_decoded
        "d_d_m2": float(np.square(there).mean() / 2 + np.square(back).mean() / 2),
    }


def _timed(work: Callable[[], _T]) -> tuple[_T, float]:
    """Return what ``work`` gives and its CPU milliseconds, those of programs that it ran included."""
    start = time.process_time() + _children()
    result = work()
    return result, 1e3 * (time.process_time() + _children() - start)


def _children() -> float:
    """CPU seconds of the child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
