"""Rate-distortion curves (after Fig. 9 of the paper) and rate against time, over the measured baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.report.baseline_figures import OURS
from salpcc.stages.evaluate.report.layout.drawing import ACCENT, COLOURS, Plot, drawing, legend

_EQUAL_ERROR = 0.01  # metres; the error at which times are compared
_MARKERS = "osD^vP*X"


class Point(NamedTuple):
    """One codec at one asked error."""

    asked: float  # metres
    bpp: float  # geometry
    d_d: float | None  # square metres
    encode_ms: float | None


Curves = Mapping[str, Sequence[Point]]


def comparison_plots(report: Mapping[str, Any]) -> list[Plot]:
    """Return the plots that the baselines' figures allow; none where no baseline was measured."""
    curves = _curves(report)
    lossy = {name: [p for p in points if p.asked > 0] for name, points in curves.items()}
    lossy = {name: points for name, points in lossy.items() if points}
    if not lossy:
        return []
    bound = {n: p for n, p in lossy.items() if n not in BASELINES or BASELINES[n].promise.bound != "none"}
    plots = [_rate_plot(bound), _distortion_plot(lossy)]
    equal = {name: [p for p in points if p.asked == _EQUAL_ERROR] for name, points in bound.items()}
    equal = {name: points for name, points in equal.items() if points and points[0].encode_ms}
    return [*plots, _time_plot(equal)] if equal else plots


def sequence_plots(report: Mapping[str, Any]) -> list[Plot]:
    """Return the curves of each sequence, as Fig. 9 has them; none where there is one sequence only."""
    measured = {name: f for name, f in report["sequences"].items() if f.get("baselines")}
    if len(measured) < 2:
        return []
    plots = []
    for name, figures in measured.items():
        lossy = {n: [p for p in points if p.asked > 0] for n, points in _curves(figures).items()}
        lossy = {n: points for n, points in lossy.items() if points}
        if lossy:
            plots.append(replace(_distortion_plot(lossy), title=f"Sequence {name}", caption=""))
    return plots


def _rate_plot(curves: Curves) -> Plot:
    """Geometry bits per point against the asked error."""
    ticks = sorted({1e3 * p.asked for points in curves.values() for p in points})
    with drawing(3.9) as (axes, svg):
        for name, style in _styles(curves):
            points = curves[name]
            axes.plot([1e3 * p.asked for p in points], [p.bpp for p in points], label=name, **style)
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
        axes.set_xlabel("asked error, mm")
        axes.set_ylabel("geometry, bits per input point")
        axes.set_ylim(bottom=0)
        legend(axes)
    caption = "Lower is better. Codecs that bound no error are left out; octree merges points."
    return Plot("Rate against the promised error", caption, "".join(svg))


def _distortion_plot(curves: Curves) -> Plot:
    """Geometry bits per point against D_d, as in Fig. 9."""
    with drawing(3.9) as (axes, svg):
        for name, style in _styles(curves):
            points = [p for p in curves[name] if p.d_d]
            axes.plot([p.bpp for p in points], [p.d_d or 0.0 for p in points], label=name, **style)
        axes.set_yscale("log")
        axes.margins(y=0.1)
        axes.set_xlabel("geometry, bits per input point")
        axes.set_ylabel("D_d, m²")
        axes.set_xlim(left=0)
        legend(axes)
    caption = (
        "D_d of eqs. (24) and (25), squared distances. Lower and further left is better. What loses points in the "
        "cells of a range image has their distances in it, whatever the accuracy."
    )
    return Plot("Distortion against rate", caption, "".join(svg))


def _time_plot(curves: Curves) -> Plot:
    """Geometry bits per point against encoding time, every codec at the same asked error."""
    times = [points[0].encode_ms or 0.0 for points in curves.values()]
    low, high = min(times), max(times)
    with drawing(3.4) as (axes, svg):
        for name, style in _styles(curves):
            point = curves[name][0]
            axes.plot([point.encode_ms or 0.0], [point.bpp], linestyle="none", label=name, **style)
        front = _front([(p[0].encode_ms or 0.0, p[0].bpp) for p in curves.values()])
        axes.step(
            *zip(*front, strict=True), where="post", color="#9aa0aa", linewidth=1, linestyle="--", zorder=1
        )
        axes.set_xscale("log")
        axes.set_xticks(
            [t for t in (1, 3, 10, 30, 100, 300, 1000, 3000, 10000, 30000) if low / 2 < t < 2 * high]
        )
        axes.xaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.set_xlabel("encoding, CPU ms a scan")
        axes.set_ylabel("geometry, bits per input point")
        axes.set_ylim(bottom=0)
        legend(axes)
    caption = (
        f"Everyone who bounds the error, at {1e3 * _EQUAL_ERROR:g} mm. Lower and further left is better; the dashed "
        "line joins those that no other beats in both."
    )
    return Plot("Rate against time", caption, "".join(svg))


def _front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Keep the points (time, rate) that no other beats in both, ascending in time: the Pareto front."""
    front: list[tuple[float, float]] = []
    for time, rate in sorted(points):
        if not front or rate < front[-1][1]:
            front.append((time, rate))
    return front


def _curves(report: Mapping[str, Any]) -> dict[str, list[Point]]:
    """Every codec's points, ascending in the asked error."""
    return {
        name: [
            Point(float(asked), f["bpp"]["geometry"], f["d_d"], f["encode_ms_per_scan"])
            for asked, f in sorted(errors.items(), key=lambda item: float(item[0]))
            if f["frames"]
        ]
        for name, errors in report["baselines"].items()
    }


def _styles(curves: Curves) -> list[tuple[str, dict[str, Any]]]:
    """Colour and marker of each codec, the same in every plot; ours stands out and is drawn last."""
    places = {name: place for place, name in enumerate(name for name in BASELINES if name != OURS)}
    styles: list[tuple[str, dict[str, Any]]] = []
    for name in (n for n in curves if n != OURS):
        place = places.get(name, len(places))
        colour = COLOURS[place % len(COLOURS)]
        marker = _MARKERS[(place + place // len(COLOURS)) % len(_MARKERS)]  # no pair twice
        styles.append((name, {"color": colour, "marker": marker, "markersize": 5}))
    if OURS in curves:
        ours = {"color": ACCENT, "marker": "o", "markersize": 6, "linewidth": 2.2, "zorder": 5}
        styles.append((OURS, ours))
    return styles
