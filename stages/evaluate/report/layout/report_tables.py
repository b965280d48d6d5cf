"""Lay the figures of ``report.json`` out as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from salpcc.stages.evaluate.measures.aggregate import ENCODE_STAGES, STREAMS
from salpcc.stages.evaluate.report.layout.comparison_tables import baseline_table, bd_rate_table
from salpcc.stages.evaluate.report.layout.downstream_tables import downstream_tables
from salpcc.stages.evaluate.report.layout.figure_rows import rows_of
from salpcc.stages.evaluate.report.layout.paper_tables import paper_tables
from salpcc.stages.evaluate.report.layout.segmentation_tables import segmentation_tables
from salpcc.stages.evaluate.report.layout.tables import Column, Table

Report = Mapping[str, Any]


def all_tables(report: Report) -> list[Table]:
    """Every table that the report has figures for."""
    return [table for make in TABLES for table in make(report)]


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
        "bpp: bits per input point, all bytes of the archive file counted but labels and side files. CR: eq. (23), of 16 bytes per input "
        "point. Errors: 3-D, point by point in file order, of what the archive decodes to. Dropped: points that "
        "the task does not keep. Times: CPU of one core, median a scan."
    )
    return Table("sequences", "What it costs", columns, rows_of(report), note, last_is_total=True)


def bytes_table(report: Report) -> Table:
    """Bytes of each stream."""
    streams = [Column(f"bytes_{stream}", stream, ",") for stream in (*STREAMS, "total")]
    shares = [Column(f"share_{stream}", f"{stream}, %", ".1f") for stream in STREAMS]
    columns = (Column("sequence", "sequence"), *streams, *shares)
    note = "Side holds checksums, and the framing and attachments of the file."
    return Table("bytes", "Bytes of each stream", columns, rows_of(report), note, last_is_total=True)


def savings_table(report: Report) -> Table:
    """What leaving out movable points saves."""
    columns = (
        Column("sequence", "sequence"),
        Column("points_in", "points", ","),
        Column("points_dropped_movable", "dropped", ","),
        Column("share_dropped", "dropped, %", ".2f"),
        Column("bytes_coded", "geometry and intensity, bytes", ","),
        Column("bytes_saved", "saved, bytes", ","),
        Column("share_saved", "saved, %", ".2f"),
        Column("bytes_saved_file", "of the whole file, bytes", ","),
        Column("how", "how it is known"),
    )
    rows = []
    for row in rows_of(report):
        coded, saved = row["bytes_geometry"] + row["bytes_intensity"], row.get("bytes_saved")
        row |= {
            "bytes_coded": coded,
            "share_dropped": 100.0 * row["points_dropped_movable"] / row["points_in"],
        }
        if saved is not None:
            row["share_saved"] = 100.0 * saved / (coded + saved)
            row["how"] = "measured" if row["savings_measured"] else "estimated"
        rows.append(row)
    note = (
        "Saved, %: of what geometry and intensity would take with these points. Measured: against a run that kept them "
        "and is shown here, too (report OUT --beside OUT_KEEP). Estimated: a dropped point is taken to cost what the "
        "others of its sequence cost; over 55 scans of SemanticKITTI that was 2 % less than measured, at most 20 % off in a "
        "sequence. Of the whole file: less, as it holds the classes of what is kept; a run that keeps everything has none."
    )
    return Table("savings", "What leaving out movables saves", columns, tuple(rows), note, last_is_total=True)


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
    return Table("times", "Time of each stage", columns, rows_of(report), note, last_is_total=True)


def failure_table(report: Report) -> Table:
    """What could not be processed."""
    keys = ("sequence", "name", "stage", "file", "message")
    columns = tuple(Column(key, "scan" if key == "name" else key) for key in keys)
    return Table("failures", "What failed", columns, tuple(report["failures"]))


# In the order of the page; each makes its tables of what is in the report, none where that is not there.
TABLES: tuple[Callable[[Report], Sequence[Table]], ...] = (
    lambda report: [sequence_table(report), bytes_table(report)],
    lambda report: [savings_table(report)] if report["total"]["points_dropped_movable"] else [],
    lambda report: [time_table(report)],
    segmentation_tables,
    lambda report: [baseline_table(report)] if report["baselines"] else [],
    lambda report: [bd_rate_table(report)] if report["baselines"] and report["bd_rate_percent"] else [],
    paper_tables,
    downstream_tables,
    lambda report: [failure_table(report)] if report["failures"] else [],
)
