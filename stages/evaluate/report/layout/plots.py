"""The plots of what a run measured: bytes by stream, time by stage; then the comparison with other codecs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from salpcc.schemas.labels import CLASSES
from salpcc.stages.evaluate.measures.aggregate import ENCODE_STAGES, STREAMS
from salpcc.stages.evaluate.report.layout.comparison_plots import comparison_plots
from salpcc.stages.evaluate.report.layout.drawing import COLOURS, Plot, drawing, legend

Report = Mapping[str, Any]


def all_plots(report: Report) -> list[Plot]:
    """Every plot that the report has figures for."""
    plots = []
    if report["sequences"]:
        plots.append(stream_plot(report))
    if any(figures["ms_per_scan"] for figures in report["sequences"].values()):
        plots.append(time_plot(report))
    if (report["total"]["iou"] or {}).get("confusion"):
        plots.append(confusion_plot(report))
    if report["coders"]:
        plots.append(coder_plot(report["coders"]))
    return plots + comparison_plots(report)


def stream_plot(report: Report) -> Plot:
    """Stacked bits per point of each stream, per sequence."""
    names = list(report["sequences"])
    layers = {
        stream: [
            8.0 * f["bytes"][stream] / f["points_in"] if f["points_in"] else 0.0
            for f in report["sequences"].values()
        ]
        for stream in STREAMS
    }
    svg = _stacked(names, layers, "bits per input point", ".1f")
    return Plot("Bits per point by stream", "The whole archive file, divided by the input points.", svg)


def time_plot(report: Report) -> Plot:
    """Stacked CPU milliseconds of the encoding stages, per sequence."""
    names = list(report["sequences"])
    rows = [figures["ms_per_scan"] for figures in report["sequences"].values()]
    layers = {stage: [row.get(stage, 0.0) for row in rows] for stage in ENCODE_STAGES}
    layers = {stage: values for stage, values in layers.items() if any(values)}
    svg = _stacked(names, layers, "CPU ms a scan", ".0f")
    return Plot("Encoding time by stage", "Medians, one core.", svg)


def confusion_plot(report: Report) -> Plot:
    """What the points of each class were taken for, all sequences together."""
    counts = np.array(report["total"]["iou"]["confusion"], np.int64)
    seen = np.flatnonzero(counts.sum(axis=0) + counts.sum(axis=1))
    names = [CLASSES[i].name for i in seen]
    counts = counts[np.ix_(seen, seen)]
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    with drawing(5.2) as (axes, svg):
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1, interpolation="none", aspect="auto")
        axes.grid(visible=False)
        axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
        axes.set_yticks(range(len(names)), names, fontsize=8)
        for i, j in zip(*np.nonzero(share >= 0.01), strict=True):
            colour = "white" if share[i, j] > 0.5 else "#1b2230"
            axes.text(j, i, f"{100 * share[i, j]:.0f}", ha="center", va="center", fontsize=7, color=colour)
        axes.set_xlabel("taken for")
        axes.set_ylabel("truth")
    return Plot("Confusion of classes", "Percent of each row; below 1 % left out.", "".join(svg))


def coder_plot(rows: Sequence[Mapping[str, Any]]) -> Plot:
    """CR of the lossless coders, on residuals and on raw scans (after Fig. 8)."""
    ran = [row for row in rows if row["rate_percent"] is not None]
    residuals = [row for row in ran if row["input"] != "raw"]
    finest = min((row["max_error"] or 0.0 for row in residuals), default=0.0)
    of = {
        "residual": {r["coder"]: r["rate_percent"] for r in residuals if (r["max_error"] or 0.0) == finest},
        "raw": {r["coder"]: r["rate_percent"] for r in ran if r["input"] == "raw"},
    }
    names = sorted(of["residual"] | of["raw"], key=lambda name: of["residual"].get(name, 1e9))
    with drawing(0.9 + 0.36 * len(names)) as (axes, svg):
        for place, (kind, rates) in enumerate(of.items()):
            where = [i + 0.4 * place - 0.2 for i, name in enumerate(names) if name in rates]
            values = [rates[name] for name in names if name in rates]
            axes.barh(where, values, height=0.38, color=COLOURS[place], label=kind)
            for y, value in zip(where, values, strict=True):
                axes.text(value, y, f" {value:.2f}", va="center", ha="left", fontsize=8)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.12)
        axes.set_xlabel("CR, % of 16 bytes per input point")
        legend(axes)
    what = f" at {1e3 * finest:g} mm" if finest else ""
    return Plot("Lossless coders (Fig. 8)", f"Residuals{what} and raw scans. Lower is better.", "".join(svg))


def _stacked(names: Sequence[str], layers: Mapping[str, Sequence[float]], label: str, form: str) -> str:
    """Horizontal stacked bars, one per name, with the sum at the end."""
    with drawing(1.0 + 0.30 * len(names)) as (axes, svg):
        left = np.zeros(len(names))
        for i, (layer, values) in enumerate(layers.items()):
            axes.barh(names, values, left=left, height=0.68, color=COLOURS[i % len(COLOURS)], label=layer)
            left += values
        for i, end in enumerate(left):
            axes.text(end, i, f" {end:{form}}", va="center", ha="left", fontsize=9)
        axes.set_xlim(0, 1.12 * left.max(initial=1e-9))
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(label)
        legend(axes)
    return "".join(svg)
