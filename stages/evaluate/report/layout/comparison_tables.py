"""Lay out the comparison with other codecs: measured, at equal distortion, and as published."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.report.layout.figure_rows import flat_row
from salpcc.stages.evaluate.report.layout.tables import Column, Table

THIS_RUN = "this run"
_PROMISES = {"exact": "bit-exact", "axis": "per axis", "distance": "3-D", "none": "no bound"}

Report = Mapping[str, Any]


def baseline_table(report: Report) -> Table:
    """Every codec at every asked error, ours in its place."""
    columns = (
        Column("codec", "codec"),
        Column("asked", "asked error"),
        Column("promise", "promises"),
        Column("bpp_geometry", "geometry, bpp", ".2f"),
        Column("bpp_total", "total, bpp", ".2f"),
        Column("compression_rate_percent", "CR, %", ".2f"),
        Column("points_lost", "points lost", ","),
        Column("in_order", "order kept"),
        Column("max_error_mm", "max error, mm", ".3f"),
        Column("max_axis_error_mm", "per axis, mm", ".3f"),
        Column("d_d", "D_d, m²", ".2e"),
        Column("encode_ms_per_scan", "encode, ms", ".0f"),
        Column("decode_ms_per_scan", "decode, ms", ".0f"),
        Column("memory_mb", "memory, MB", ".0f"),
        Column("remark", "remark"),
    )
    rows = [(error, name, f) for name, errors in report["baselines"].items() for error, f in _told(errors)]
    asked = report["run"].get("config", {}).get("max_error") or 0.0
    if report["total"]["frames"]:
        worst = report["total"]["max_error_m"]
        kept = None if worst is None else worst <= asked
        ours = report["total"] | {"in_order": True, "status": "ok", "promise_kept": kept}
        rows.append((f"{asked:g}", THIS_RUN, ours))
    rows.sort(key=_place)
    note = (
        "The asked error is per axis where the codec promises that, 3-D (stricter) for ours. Errors of a codec "
        "that keeps no order are nearest-neighbour distances both ways. Row 'this run': all its scans in groups, "
        "the whole archive file counted, only what the task keeps. Row 'salpcc': the baselines' scans one at a "
        "time, every point, payload only, like the others. hevc_inter, feng and sun take consecutive scans together. "
        "The shipped weights of salpcc were trained on SemanticKITTI 00 to 07 and 09 (and KITTI raw): on those scans its "
        "rows are better than on new ones; the model card has held-out figures. "
        "Memory: what a codec takes at most, over the scans that it is given; programs that it calls not counted."
    )
    shown = tuple(_baseline_row(*row) for row in rows)
    return Table("baselines", "Beside other codecs", columns, shown, note, grouped="asked")


def bd_rate_table(report: Report) -> Table:
    """Rate of the other codecs over ours, and over TMC13 where it ran, at equal D_d."""
    references = report["bd_rate_percent"]
    columns = (
        Column("codec", "codec"),
        *(Column(name, f"geometry bits more than {name}, %", "+.0f") for name in references),
    )
    names = dict.fromkeys(name for rates in references.values() for name in rates)
    rows = tuple(
        {"codec": name} | {reference: rates.get(name) for reference, rates in references.items()}
        for name in names
    )
    note = (
        "Bjøntegaard's delta rate over the D_d that both curves reach, one scan at a time for those that know no "
        "groups; a dash: they reach none in common."
    )
    return Table("bd_rate", "Rate at equal distortion", columns, rows, note)


def _told(errors: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield a codec's asked errors and figures; one row is enough where it did not run."""
    for error, figures in errors.items():
        yield error, figures
        if str(figures["status"]).startswith("not run"):
            return


def _place(row: tuple[str, str, Mapping[str, Any]]) -> tuple[bool, float, float, str]:
    """By asked error, then by rate; what did not run stands at the end."""
    asked, codec, figures = row
    rate = (figures.get("bpp") or {}).get("geometry")
    return str(figures.get("status")).startswith("not run"), float(asked), rate or 1e9, codec


def _baseline_row(asked: str, codec: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    row = flat_row(codec, figures)
    status = figures.get("status", "ok")
    label = "bit-exact" if float(asked) == 0 else f"{1e3 * float(asked):g} mm"
    if status.startswith("not run"):
        label = "any"
    promise = _PROMISES[BASELINES[codec].promise.bound] if codec in BASELINES else _PROMISES["distance"]
    if figures.get("promise_kept") is not None:
        promise += ", kept" if figures["promise_kept"] else ", BROKEN"
    remark = "" if status == "ok" else status
    return row | {"asked": label, "codec": codec, "promise": promise, "remark": remark}
