"""What leaving out movable points saves: measured against a run that keeps them, else estimated.

What is not coded has no size of its own, so only a second run can measure it: ``report OUT --beside OUT_KEEP``.
Without one, a dropped point is taken to cost what a kept one of its sequence costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

_SAME = ("profile", "max_error", "effort", "coder", "gop", "sensor_digest")
_CODED = (
    "geometry",
    "intensity",
)  # classes are another matter: a run that keeps everything need not know them


def add_savings(
    run: Mapping[str, Any], config: Mapping[str, Any], beside: Iterable[Mapping[str, Any]]
) -> None:
    """Say what was saved in the figures of a run that dropped something, in place.

    ``bytes_saved`` of geometry and intensity, ``savings_measured`` (else estimated) and, where measured,
    ``bytes_saved_file`` of the whole archive.

    Args:
        run: ``sequences`` and ``total`` of the run.
        config: its configuration.
        beside: other runs, with ``config`` and ``sequences``; one that keeps movables and is coded alike measures.
    """
    keeping = [o for o in beside if o["config"].get("keep_movable") and _alike(o["config"], config)]
    found = []
    for name, figures in run["sequences"].items():
        if figures["points_dropped_movable"]:
            there = (o["sequences"].get(name) for o in keeping)
            found.append(_saved(figures, next((o for o in there if o and _same_scans(o, figures)), None)))
            figures |= found[-1]
    if found:
        measured = all(one["savings_measured"] for one in found)
        run["total"]["bytes_saved"] = sum(one["bytes_saved"] for one in found)
        run["total"]["savings_measured"] = measured
        run["total"]["bytes_saved_file"] = sum(one["bytes_saved_file"] for one in found) if measured else None


def coded_bytes(figures: Mapping[str, Any]) -> int:
    """Bytes of the streams that savings are about: geometry and intensity."""
    return sum(int(figures["bytes"][stream]) for stream in _CODED)


def _saved(figures: Mapping[str, Any], keeping: Mapping[str, Any] | None) -> dict[str, Any]:
    if keeping is not None:
        file = keeping["bytes"]["total"] - figures["bytes"]["total"]
        coded = coded_bytes(keeping) - coded_bytes(figures)
        return {"bytes_saved": coded, "savings_measured": True, "bytes_saved_file": file}
    dropped = figures["points_dropped_movable"]
    coded = round(dropped * coded_bytes(figures) / max(figures["points_in"] - dropped, 1))
    return {"bytes_saved": coded, "savings_measured": False, "bytes_saved_file": None}


def _alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return all(one.get(key) == other.get(key) for key in _SAME)


def _same_scans(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return all(one[key] == other[key] for key in ("frames", "points_in"))
