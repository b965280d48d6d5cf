"""The plots of what a run measured: bytes by stream, time by stage; then the comparison with other codecs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from salpcc.stages.evaluate.aggregate import ENCODE_STAGES, STREAMS
from salpcc.stages.evaluate.layout.comparison_plots import comparison_plots
from salpcc.stages.evaluate.layout.drawing import COLOURS, Plot, drawing, legend

Report = Mapping[str, Any]


def all_plots(report: Report) -> list[Plot]:
    """Every plot that the report has figures for."""
    plots = []
    if report["sequences"]:
        plots.append(stream_plot(report))
    if any(figures["ms_per_scan"] for figures in report["sequences"].values()):
        plots.append(time_plot(report))
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
