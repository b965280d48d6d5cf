"""Draw the report's plots as inline SVG; text stays text, so that they are sharp on paper and on a phone."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from salpcc.stages.evaluate.aggregate import ENCODE_STAGES, STREAMS

Report = Mapping[str, Any]

_COLOURS = ("#2b5c94", "#e0902f", "#4f9d69", "#8d93a1", "#b5526a", "#6f5aa8", "#3fa7b5", "#a98a3a")
_OURS = "#c22f3f"
_STYLE: Any = {  # rc_context wants its keys as literals
    "svg.fonttype": "none",
    "svg.hashsalt": "salpcc",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e8ec",
    "axes.axisbelow": True,
    "axes.edgecolor": "#9aa0aa",
    "legend.frameon": False,
}
_WIDTH = 5.6  # inches; narrow enough that the text is readable on a phone


@dataclass(frozen=True)
class Plot:
    """One drawing: its title, a sentence that says what to see, and the SVG."""

    title: str
    caption: str
    svg: str


def all_plots(report: Report) -> list[Plot]:
    """Every plot that the report has figures for."""
    plots = []
    if report["sequences"]:
        plots.append(stream_plot(report))
    if any(figures["ms_per_scan"] for figures in report["sequences"].values()):
        plots.append(time_plot(report))
    curves = _curves(report)
    if curves:
        plots += [rate_plot(curves), pareto_plot(curves)]
    return plots


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


def rate_plot(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Plot:
    """Rate-distortion: geometry bits per point against the asked error."""
    with rc_context(_STYLE):
        figure, axes = _axes(3.9)
        for name, style in _styles(curves):
            points = [p for p in curves[name] if p["asked"] > 0]
            if points:
                x = [1e3 * p["asked"] for p in points]
                axes.plot(x, [p["bpp"] for p in points], label=name, **style)
        axes.set_xscale("log")
        axes.set_xlabel("asked error, mm")
        axes.set_ylabel("geometry, bits per input point")
        axes.set_ylim(bottom=0)
        ticks = sorted({1e3 * p["asked"] for points in curves.values() for p in points if p["asked"] > 0})
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
        _legend(figure, axes)
        svg = _svg(figure)
    return Plot("Rate against error", "Lower is better. Bit-exact codings are in the next plot.", svg)


def pareto_plot(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Plot:
    """Bits per point against encoding time."""
    with rc_context(_STYLE):
        figure, axes = _axes(3.9)
        for name, style in _styles(curves):
            points = [p for p in curves[name] if p["encode_ms"]]
            if points:
                style = style | {"linestyle": "none"}
                axes.plot([p["encode_ms"] for p in points], [p["bpp"] for p in points], label=name, **style)
        axes.set_xscale("log")
        axes.set_xlabel("encoding, CPU ms a scan")
        axes.set_ylabel("geometry, bits per input point")
        axes.set_ylim(bottom=0)
        _legend(figure, axes)
        svg = _svg(figure)
    return Plot("Rate against time", "One mark per asked error. Lower and further left is better.", svg)


def _curves(report: Report) -> dict[str, list[dict[str, float]]]:
    """Per codec its (asked error, bpp, encode ms) points; empty where no baseline was measured."""
    curves: dict[str, list[dict[str, float]]] = {}
    for name, errors in report["baselines"].items():
        for asked, figures in errors.items():
            if figures["frames"]:
                curves.setdefault(name, []).append(_point(float(asked), figures))
    if curves and report["total"]["frames"]:
        asked = float(report["run"].get("config", {}).get("max_error") or 0.0)
        curves["salpcc"] = [_point(asked, report["total"])]
    return curves


def _point(asked: float, figures: Mapping[str, Any]) -> dict[str, float]:
    return {
        "asked": asked,
        "bpp": figures["bpp"]["geometry"],
        "encode_ms": figures["encode_ms_per_scan"] or 0.0,
    }


def _styles(curves: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Colour and marker of each codec; ours stands out and is drawn last."""
    markers = "osD^vP*X"
    styles: list[tuple[str, dict[str, Any]]] = []
    for i, name in enumerate(n for n in curves if n != "salpcc"):
        colour = _COLOURS[i % len(_COLOURS)]
        styles.append((name, {"color": colour, "marker": markers[i % len(markers)], "markersize": 5}))
    if "salpcc" in curves:
        styles.append(("salpcc", {"color": _OURS, "marker": "*", "markersize": 13, "zorder": 5}))
    return styles


def _stacked(names: Sequence[str], layers: Mapping[str, Sequence[float]], label: str, form: str) -> str:
    """Horizontal stacked bars, one per name, with the sum at the end."""
    with rc_context(_STYLE):
        figure, axes = _axes(1.0 + 0.30 * len(names))
        left = np.zeros(len(names))
        for i, (layer, values) in enumerate(layers.items()):
            axes.barh(names, values, left=left, height=0.68, color=_COLOURS[i % len(_COLOURS)], label=layer)
            left += values
        for i, end in enumerate(left):
            axes.text(end, i, f" {end:{form}}", va="center", ha="left", fontsize=9)
        axes.set_xlim(0, 1.12 * left.max(initial=1e-9))
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(label)
        _legend(figure, axes)
        return _svg(figure)


def _axes(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    return figure, figure.add_subplot()


def _legend(figure: Figure, axes: Axes) -> None:
    """Set the legend above the axes, where it covers nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper left", ncols=min(5, len(labels)), fontsize=9)


def _svg(figure: Figure) -> str:
    """Give the SVG element alone, without a fixed size, so that the page scales it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    return re.sub(r'(<svg[^>]*?) width="[^"]*"| height="[^"]*pt"', r"\1", svg, count=2)
