"""What the archives are for: registration (Table V), clean maps, and studies that other commands record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from salpcc.stages.evaluate.report.layout.runs import accuracy_label
from salpcc.stages.evaluate.report.layout.tables import Column, Table

Report = Mapping[str, Any]


def downstream_tables(report: Report) -> list[Table]:
    """The tables whose records are there."""
    tables = [coder_table(report["coders"])] if report["coders"] else []
    tables += [
        ablation_table(i, study, rows) for i, (study, rows) in enumerate(report["ablations"].items(), 1)
    ]
    tables += [table_5(report["registration"])] if report["registration"] else []
    tables += [localisation_table(report["localisation"])] if report.get("localisation") else []
    return tables + ([map_table(report["map_quality"])] if report["map_quality"] else [])


def coder_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Fig. 8: CR of each lossless coder, on residuals and on the scans as they are."""
    columns = (
        Column("coder", "coder"),
        Column("what", "input"),
        Column("settings", "settings"),
        Column("rate_percent", "CR, %", ".2f"),
        Column("encode_ms", "encode, ms", ".1f"),
        Column("decode_ms", "decode, ms", ".1f"),
        Column("remark", "remark"),
    )
    shown = [
        {
            **row,
            "what": "raw scan"
            if row["input"] == "raw"
            else f"residual, {accuracy_label(row['max_error'] or 0)}",
            "remark": "" if row["status"] == "ok" else row["status"],
        }
        for row in rows
    ]
    note = "CR: bytes of the coder over 16 bytes per input point, all sequences together. Times: CPU a million points."
    return Table("fig8", "Lossless coders (Fig. 8)", columns, tuple(shown), note, grouped="what")


_ERRORS_OF_POSE = tuple(
    Column(f"{kind}_{unit}_{figure}", f"{kind}, {unit}, {figure}", ".4f")
    for kind, unit in (("rotation", "deg"), ("translation", "m"))
    for figure in ("mean", "std", "median")
)


def ablation_table(number: int, study: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """One study: a row per sequence and variant, a column per measure."""
    measures = list(dict.fromkeys(key for row in rows for key in row if key not in ("sequence", "variant")))
    columns = (
        Column("variant", "variant"),
        Column("sequence", "sequence"),
        *(Column(measure, measure, ".4g") for measure in measures),
    )
    return Table(f"ablation{number}", study, columns, tuple(rows), grouped="sequence")


def table_5(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Mean and spread of the registration errors of consecutive scans, by cloud."""
    columns = (
        Column("cloud", "cloud"),
        Column("asked", "asked error"),
        Column("movable", "movables in it"),
        Column("method", "ICP"),
        Column("sequence", "sequence"),
        Column("bpp", "bpp", ".2f"),
        Column("pairs", "pairs", ","),
        *_ERRORS_OF_POSE,
    )
    shown = [
        {**row, "asked": "-" if row["max_error"] is None else accuracy_label(row["max_error"])}
        for row in rows
    ]
    note = (
        "Errors by eqs. (26) and (27) with d_res = 1, over all pairs of consecutive scans; std: their spread. "
        "The paper shows three pairs."
    )
    return Table(
        "table5",
        "Registration of consecutive scans (Table V)",
        columns,
        tuple(shown),
        note,
        grouped="sequence",
    )


def localisation_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Mean and spread of the errors of scans localised in maps."""
    columns = (
        Column("map", "map"),
        Column("asked", "asked error"),
        Column("movable", "movables in the scan"),
        Column("method", "ICP"),
        Column("sequence", "sequence"),
        Column("scans", "scans", ","),
        Column("lost", "lost", ","),
        *_ERRORS_OF_POSE,
    )
    shown = [{**row, "asked": accuracy_label(row["max_error"])} for row in rows]
    note = "Each scan begins where the one before it was. Lost: farther than a metre off, and in no mean."
    return Table("localisation", "Localisation in maps", columns, tuple(shown), note, grouped="sequence")


def map_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """How clean the maps are, and what cleaning costs them."""
    columns = (
        Column("cleaner", "cleaner"),
        Column("cloud", "scans"),
        Column("truth", "to be removed"),
        Column("sequence", "sequence"),
        *(Column(name, name.upper(), ".4f") for name in ("sa", "da", "aa", "pr", "rr", "f1")),
        Column("scans", "scans, number", ","),
        Column("points", "points of the map", ","),
        Column("seconds", "CPU s", ".1f"),
    )
    note = (
        "SA, DA, AA: static, dynamic and associated accuracy of points, as in the DynamicMap benchmark; PR, RR, F1: "
        "preservation, rejection and their mean on voxels, as in ERASOR. Cleaner 'none' is plain accumulation."
    )
    return Table("map", "Clean maps", columns, tuple(rows), note, grouped="truth")
