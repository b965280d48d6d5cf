"""Lay the figures of ``report.json`` out as tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from salpcc.schemas.labels import CLASSES, GROUPS
from salpcc.stages.evaluate.aggregate import ENCODE_STAGES, STREAMS
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.published import PAPER
from salpcc.stages.evaluate.tables import Column, Table

Report = Mapping[str, Any]
TOTAL = "all"
THIS_RUN = "this run"
_PROMISES = {"exact": "bit-exact", "axis": "each axis", "distance": "3-D", "none": "no bound"}


def all_tables(report: Report) -> list[Table]:
    """Every table that the report has figures for."""
    tables = [sequence_table(report), bytes_table(report), time_table(report)]
    if any(figures["iou"] for figures in report["sequences"].values()):
        tables.append(iou_table(report))
    if report["baselines"]:
        tables.append(baseline_table(report))
        if report["bd_rate_percent"]:
            tables.append(bd_rate_table(report))
        tables.append(published_table())
    if report["failures"]:
        tables.append(failure_table(report))
    return tables


def sequence_table(report: Report) -> Table:
    """The headline: what each sequence costs, and how far it comes back from its source."""
    columns = (
        Column("sequence", "sequence"),
        Column("frames", "scans", ","),
        Column("points_in", "points", ","),
        Column("bpp_geometry", "geometry, bpp", ".2f"),
        Column("bpp_intensity", "intensity, bpp", ".2f"),
        Column("bpp_total", "total, bpp", ".2f"),
        Column("compression_rate_percent", "CR, %", ".2f"),
        Column("bit_exact_scans", "bit-exact scans", ","),
        Column("max_error_mm", "max error, mm", ".3f"),
        Column("rms_error_mm", "RMS error, mm", ".3f"),
        Column("d_d", "D_d, m²", ".2e"),
        Column("points_dropped_movable", "dropped", ","),
        Column("points_lost", "lost", ","),
        Column("points_on_fallback", "fallback", ","),
        Column("encode_ms_per_scan", "encode, ms", ".0f"),
        Column("decode_ms_per_scan", "decode, ms", ".0f"),
    )
    note = (
        "bpp: bits per input point, all bytes of the archive file counted. CR: eq. (23), of 16 bytes per input "
        "point. Errors: 3-D, point by point in file order, of what the archive decodes to. Dropped: points that "
        "the task does not keep. Times: CPU of one core, median a scan."
    )
    return Table("sequences", "What it costs", columns, _rows(report), note, last_is_total=True)


def summary_table(report: Report) -> Table:
    """The headline in few columns, for the README."""
    wanted = [
        "sequence",
        "frames",
        "points_in",
        "bpp_geometry",
        "bpp_intensity",
        "bpp_total",
        "compression_rate_percent",
        "bit_exact_scans",
        "points_lost",
        "encode_ms_per_scan",
        "decode_ms_per_scan",
    ]
    full = sequence_table(report)
    by_key = {column.key: column for column in full.columns}
    columns = tuple(by_key[key] for key in wanted)
    return Table("summary", full.title, columns, full.rows, full.note, last_is_total=True)


def bytes_table(report: Report) -> Table:
    """Bytes of each stream."""
    streams = [Column(f"bytes_{stream}", stream, ",") for stream in (*STREAMS, "total")]
    shares = [Column(f"share_{stream}", f"{stream}, %", ".1f") for stream in STREAMS]
    columns = (Column("sequence", "sequence"), *streams, *shares)
    note = (
        "Side holds motion, checksums, exceptions' bookkeeping, and the framing and attachments of the file."
    )
    return Table("bytes", "Bytes of each stream", columns, _rows(report), note, last_is_total=True)


def time_table(report: Report) -> Table:
    """CPU milliseconds of each stage."""
    present = {stage for figures in report["sequences"].values() for stage in figures["ms_per_scan"]}
    order = [s for s in ENCODE_STAGES if s in present] + sorted(present - set(ENCODE_STAGES))
    columns = (
        Column("sequence", "sequence"),
        *(Column(f"ms_{stage}", stage, ".1f") for stage in order),
        Column("encode_ms_per_scan", "encode", ".1f"),
        Column("decode_ms_per_scan", "decode", ".1f"),
    )
    note = "CPU milliseconds a scan on one core, median over the groups of pictures (decode: over the scans)."
    return Table("times", "Time of each stage", columns, _rows(report), note, last_is_total=True)


def iou_table(report: Report) -> Table:
    """IoU of the groups and mIoU, then each class that occurs."""
    named = [c.name for c in CLASSES]
    seen = {name for f in report["sequences"].values() for name in ((f["iou"] or {}).get("classes") or {})}
    columns = (
        Column("sequence", "sequence"),
        *(Column(f"group_{name}", name, ".3f") for name in GROUPS),
        Column("miou", "mIoU", ".3f"),
        *(Column(f"class_{name}", name, ".3f") for name in named if name in seen),
    )
    note = (
        "IoU, eq. (21), against the given labels. Unlabelled points do not count; a dash: not in these scans."
    )
    if report["run"].get("config", {}).get("labels") == "given":
        note += " This run took its classes from those very labels."
    return Table("iou", "Segmentation", columns, _rows(report), note, last_is_total=True)


def baseline_table(report: Report) -> Table:
    """Every codec at every asked error, ours in its place."""
    columns = (
        Column("asked", "asked error"),
        Column("codec", "codec"),
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
        Column("remark", "remark"),
    )
    rows = [(error, name, f) for name, errors in report["baselines"].items() for error, f in errors.items()]
    asked = report["run"].get("config", {}).get("max_error") or 0.0
    if report["total"]["frames"]:
        rows.append((f"{asked:g}", THIS_RUN, report["total"] | {"in_order": True, "status": "ok"}))
    rows.sort(key=lambda row: (float(row[0]), (row[2].get("bpp") or {}).get("geometry") or 1e9, row[1]))
    note = (
        "The asked error is per axis where the codec promises that, 3-D (stricter) for ours. Errors of a codec "
        "that keeps no order are nearest-neighbour distances both ways. Row 'this run': all its scans in groups, "
        "the whole archive file counted, only what the task keeps. Row 'salpcc': the baselines' scans one at a "
        "time, every point, payload only, like the others."
    )
    return Table(
        "baselines", "Beside other codecs", columns, tuple(_baseline_row(*row) for row in rows), note
    )


def bd_rate_table(report: Report) -> Table:
    """Rate of the other codecs over ours at equal D_d."""
    columns = (
        Column("codec", "codec"),
        Column("bd_rate", "geometry bits more than salpcc, %", "+.0f"),
    )
    rows = tuple({"codec": name, "bd_rate": rate} for name, rate in report["bd_rate_percent"].items())
    note = (
        "Bjøntegaard's delta rate over the D_d that both curves reach, one scan at a time; a dash: they reach "
        "none in common."
    )
    return Table("bd_rate", "Rate at equal distortion", columns, rows, note)


def published_table() -> Table:
    """What the paper publishes, for orientation; measured by its authors, on their machine."""
    columns = (
        Column("system", "system (published)"),
        Column("accuracy_mm", "accuracy, mm", "g"),
        Column("rate_percent", "CR, %", ".2f"),
        Column("encode_s", "encode, s", ".3f"),
        Column("decode_s", "decode, s", ".3f"),
    )
    rows = tuple(
        row._asdict() | {"accuracy_mm": None if row.accuracy is None else 1e3 * row.accuracy} for row in PAPER
    )
    note = (
        "Tables II and III of the SA-LPCC paper, sequences 11 to 21, not measured here. Its rates are taken after "
        "dropping movable points and losing points that collide in the range image."
    )
    return Table("published", "Published figures", columns, rows, note)


def failure_table(report: Report) -> Table:
    """What could not be processed."""
    keys = ("sequence", "name", "stage", "file", "message")
    columns = tuple(Column(key, "scan" if key == "name" else key) for key in keys)
    return Table("failures", "What failed", columns, tuple(report["failures"]))


def _rows(report: Report) -> tuple[Mapping[str, Any], ...]:
    """One flat row per sequence, and the total where there are several."""
    named: Iterable[tuple[str, Mapping[str, Any]]] = report["sequences"].items()
    rows = [_flat(name, figures) for name, figures in named]
    return (*rows, _flat(TOTAL, report["total"]))


def _flat(name: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten the nested figures of one sequence, errors in millimetres."""
    row = {"sequence": name, **{k: v for k, v in figures.items() if not isinstance(v, Mapping)}}
    for group, prefix in (("bpp", "bpp"), ("bytes", "bytes"), ("ms_per_scan", "ms")):
        row |= {f"{prefix}_{key}": value for key, value in (figures.get(group) or {}).items()}
    size = figures["bytes"]["total"] if figures.get("bytes") else None
    if size:
        row |= {f"share_{s}": 100.0 * (figures["bytes"].get(s) or 0) / size for s in STREAMS}
    iou = figures.get("iou") or {}
    row |= {f"group_{key}": value for key, value in (iou.get("groups") or {}).items()}
    row |= {f"class_{key}": value for key, value in (iou.get("classes") or {}).items()}
    row["miou"] = iou.get("miou")
    for kind in ("max", "max_axis", "rms"):
        error = figures.get(f"{kind}_error_m")
        row[f"{kind}_error_mm"] = None if error is None else 1e3 * error
    return row


def _baseline_row(asked: str, codec: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    row = _flat(codec, figures)
    status = figures.get("status", "ok")
    label = "bit-exact" if float(asked) == 0 else f"{1e3 * float(asked):g} mm"
    promise = _PROMISES[BASELINES[codec].promise.bound] if codec in BASELINES else _PROMISES["distance"]
    remark = "" if status == "ok" else status
    return row | {"asked": label, "codec": codec, "promise": promise, "remark": remark}
