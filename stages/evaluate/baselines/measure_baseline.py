"""Run one baseline on consecutive scans at one asked error, and measure what comes back."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines.baseline import Baseline, Points
from salpcc.stages.evaluate.baselines.memory import peak_above
from salpcc.stages.evaluate.baselines.nearest import errors_in_order, errors_nearest
from salpcc.stages.evaluate.measures.metrics import same_bits

ERRORS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)  # metres; what users ask for, and a curve's worth of them

VERSION = 2  # of what is measured; another one measures everything again

_T = TypeVar("_T")
Row = dict[str, Any]  # of the BASELINES table


def asked_errors(baseline: Baseline) -> tuple[float, ...]:
    """Return the errors that a baseline is measured at; 0 is bit-exact."""
    return {"exact": (0.0,), "distance": (0.0, *ERRORS)}.get(baseline.promise.bound, ERRORS)


def empty_row(name: str, scan: Scan, sequence: str, max_error: float, status: str) -> Row:
    """Return a BASELINES row that says only why nothing was measured."""
    return {
        "baseline": name,
        "sequence": sequence,
        "name": scan.name,
        "max_error": max_error,
        "points_in": len(scan),
        "status": status,
    }


def measure(
    name: str, baseline: Baseline, scans: Sequence[Scan], sequence: str, max_error: float
) -> list[Row]:
    """Return one BASELINES row per scan. Never raises for what the codec does: the rows' status says it.

    The scans are coded together where the codec does that; its time is shared out evenly among them.
    """
    if missing := baseline.missing():
        return [empty_row(name, scan, sequence, max_error, f"not run: {missing}") for scan in scans]
    rows = [empty_row(name, scan, sequence, max_error, "ok") for scan in scans]
    try:
        measured = _measure(baseline, scans, max_error)
    except Exception as error:  # noqa: BLE001  whatever a foreign codec throws costs its rows and nothing else
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        return [row | {"status": f"failed: {reason[:200]}"} for row in rows]
    return [row | found for row, found in zip(rows, measured, strict=True)]


def warm_up(baseline: Baseline, scans: Sequence[Scan], max_error: float) -> None:
    """Let imports and compilation happen outside the measured times."""
    together = baseline.together()
    with suppress(Exception):  # the measurement that follows will say what is wrong
        together.decode(together.encode([np.ascontiguousarray(scan.points) for scan in scans], max_error))


def _measure(baseline: Baseline, scans: Sequence[Scan], max_error: float) -> list[Row]:
    """Encode and decode the geometry, and with intensity where the codec carries it; compare.

    Times and memory are those of all that the codec carries.
    """
    together = baseline.together()
    clouds = [np.ascontiguousarray(scan.points) for scan in scans]
    whole = clouds
    if baseline.promise.intensity:
        whole = [np.column_stack([scan.points, scan.intensity]) for scan in scans]
    with peak_above() as memory:
        data, encode_ms = _timed(baseline, lambda: together.encode(whole, max_error))
        decoded, decode_ms = _timed(baseline, lambda: together.decode(data))
    if baseline.geometry is not None:
        geometry = [baseline.geometry(piece) for piece in data]
    else:
        plain = data if whole is clouds else together.encode(clouds, max_error)
        geometry = [len(piece) for piece in plain]
    rows = []
    for points, given, back, piece, size in zip(clouds, whole, decoded, data, geometry, strict=True):
        in_order = baseline.promise.order and len(back) == len(points)
        row: Row = {
            "bytes_geometry": size,
            "encode_ms": encode_ms / len(scans),
            "decode_ms": decode_ms / len(scans),
            "memory_mb": memory.megabytes,
            "points_decoded": len(back),
            "in_order": in_order,
            "bit_exact": same_bits(given, back),
        }
        if whole is not clouds:
            row["bytes_total"] = len(piece)
        rows.append(row | _errors(points, np.ascontiguousarray(back[:, :3]), in_order))
    return rows


def _errors(points: Points, decoded: Points, in_order: bool) -> Row:
    return errors_in_order(points, decoded) if in_order else errors_nearest(points, decoded)


def _timed(baseline: Baseline, work: Callable[[], _T]) -> tuple[_T, float]:
    """Return what ``work`` gives and its CPU milliseconds: those that its program tells, else all that were spent."""
    start = time.process_time() + _children()
    result = work()
    spent = time.process_time() + _children() - start
    told = baseline.own_seconds() if baseline.own_seconds is not None else None
    return result, 1e3 * (spent if told is None else told)


def _children() -> float:
    """CPU seconds of the child processes that have ended."""
    spent = os.times()
    return spent.children_user + spent.children_system
