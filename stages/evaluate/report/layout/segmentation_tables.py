"""Table I: what the segmentation finds, beside what the paper publishes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from salpcc.schemas.labels import CLASSES, GROUPS
from salpcc.stages.evaluate.report.layout.figure_rows import rows_of
from salpcc.stages.evaluate.report.layout.published import SEGMENTATION, SEGMENTED
from salpcc.stages.evaluate.report.layout.runs import Run, all_runs
from salpcc.stages.evaluate.report.layout.tables import Column, Table

Report = Mapping[str, Any]


def segmentation_tables(report: Report) -> list[Table]:
    """Table I where a network was measured against labels; the groups and classes of this run where it has any."""
    tables = []
    measured = [run for run in all_runs(report) if _is_measured(run)]
    if measured:
        tables.append(table_1(measured))
    if report["total"]["iou"]:
        tables += [group_table(report), class_table(report)]
    return tables


def table_1(runs: list[Run]) -> Table:
    """IoU of the paper's twelve classes in percent, as published and as measured."""
    columns = (
        Column("method", "method"),
        Column("fps", "FPS", ".1f"),
        Column("miou", "mIoU, %", ".2f"),
        *(Column(name, name, ".1f") for name in SEGMENTED),
    )
    keys = ("fps", "miou", *SEGMENTED)
    rows = [
        {"method": f"{name} (published)", **dict(zip(keys, values, strict=True))}
        for name, values in SEGMENTATION.items()
    ]
    note = (
        "Published rows: the paper's Table I, its scans, its GPU. Measured: this pipeline's network on the sequences "
        "named, every point counted, dropped ones too; FPS is scans a CPU second of the whole stage. mIoU: over "
        "those of the twelve classes that occur; a dash: not in these scans. Where the shipped weights were trained on "
        "these very sequences, the model card has the figures of held-out ones."
    )
    return Table("table1", "Segmentation (Table I)", columns, (*rows, *map(_measured_row, runs)), note)


def group_table(report: Report) -> Table:
    """IoU of the three groups, with terrain as other and without it."""
    columns = (
        Column("sequence", "sequence"),
        *(Column(f"group_{name}", name, ".3f") for name in reversed(GROUPS)),
        Column("movable_recall", "movable, recall", ".3f"),
        Column("movable_precision", "movable, precision", ".3f"),
        *(Column(f"bare_{name}", f"{name} *", ".3f") for name in reversed(GROUPS)),
    )
    note = (
        "IoU, eq. (21), against the given labels; unlabelled points do not count, dropped ones count as movable. "
        "*: points of class terrain left out, as no group of the paper has them; else they are other."
    )
    return Table(
        "groups", "What the task needs to know", columns, rows_of(report), note + _given(report), True
    )


def class_table(report: Report) -> Table:
    """IoU of every class that occurs."""
    seen = set(report["total"]["iou"]["classes"])
    columns = (
        Column("sequence", "sequence"),
        Column("miou", "mIoU", ".3f"),
        Column("miou_paper", "mIoU, the paper's classes", ".3f"),
        *(Column(f"class_{c.name}", c.name, ".3f") for c in CLASSES if c.name in seen),
    )
    note = "IoU, eq. (21), against the given labels; a dash: not in these scans."
    return Table("iou", "Segmentation by class", columns, rows_of(report), note + _given(report), True)


def _is_measured(run: Run) -> bool:
    return run.config.get("labels") != "given" and bool((run.total["iou"] or {}).get("classes"))


def _measured_row(run: Run) -> dict[str, Any]:
    iou, ms = run.total["iou"], run.total["ms_per_scan"].get("segment")
    names = ", ".join(run.sequences)
    return {
        "method": f"measured here, {names}",
        "fps": 1e3 / ms if ms else None,
        "miou": None if iou["miou_paper"] is None else 100 * iou["miou_paper"],
        **{name: 100 * score for name, score in iou["classes"].items()},
    }


def _given(report: Report) -> str:
    given = report["run"].get("config", {}).get("labels") == "given"
    return " This run took its classes from those very labels." if given else ""
