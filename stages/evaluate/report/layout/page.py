"""Write the report as one HTML page that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined

from salpcc.stages.evaluate.report.layout.comparison_plots import sequence_plots
from salpcc.stages.evaluate.report.layout.gallery import Gallery
from salpcc.stages.evaluate.report.layout.paper_tables import published_tables
from salpcc.stages.evaluate.report.layout.plots import all_plots
from salpcc.stages.evaluate.report.layout.report_tables import all_tables
from salpcc.stages.evaluate.report.layout.runs import all_runs
from salpcc.stages.evaluate.report.layout.scene import Scene


def render_page(
    report: Mapping[str, Any],
    galleries: Sequence[Gallery],
    scene: Scene | None = None,
    paper: bool = False,
) -> str:
    """Fill ``page.html.j2`` with everything that the report has figures for, a scan to turn, and what the ``paper`` publishes."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        files(__package__).joinpath("page.html.j2").read_text(encoding="utf-8")
    )
    return template.render(
        report=report,
        run=report["run"],
        total=report["total"],
        claims=headline(report),
        tables=all_tables(report),
        published=published_tables() if paper else [],
        missing=missing_parts(report) if paper else [],
        plots=all_plots(report),
        sequence_plots=sequence_plots(report),
        galleries=galleries,
        scene=scene,
    )


def missing_parts(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What this report could show and does not, and the command that measures it."""
    iou = report["total"]["iou"] or {}
    parts = [
        (iou, "Table I, Fig. 7", "run sequences … --labels network, on sequences that have .label files"),
        (
            any(run.of_paper for run in all_runs(report)),
            "Tables II, IV",
            "run sequences … --profile paper --max-error 0.001 --out PAPER; report OUT --beside PAPER",
        ),
        (report["baselines"], "Table III, Fig. 9, other codecs", "run sequences … --baselines all"),
        (
            report["registration"],
            "Table V",
            "localise ARCHIVE… --against ROOT --rivals draco --out LOC; report OUT --beside LOC",
        ),
        (
            report["map_quality"],
            "Fig. 10, clean maps",
            "map ARCHIVE… --against ROOT --out MAP; report OUT --beside MAP",
        ),
    ]
    return [(what, command) for there, what, command in parts if not there]


def headline(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The handful of figures that a reader looks for first, as (figure, what it is)."""
    total = report["total"]
    if not total["frames"]:
        return []
    claims = [
        (f"{total['compression_rate_percent']:.2f} %", "of 16 B per point (x, y, z, intensity)"),
        (f"{total['bpp']['geometry']:.2f}", "bits per point for geometry"),
        (f"{total['bpp']['intensity']:.2f}", "bits per point for intensity"),
    ]
    if total["bit_exact_scans"] == total["frames"]:
        claims.append(("bit-exact", f"all {total['frames']} scans, every float32 of what is kept"))
    elif total["max_error_m"] is not None:
        claims.append((f"{1e3 * total['max_error_m']:.2f} mm", "largest error of any point (3-D)"))
    else:
        claims.append(("not proven", "no source to compare with, or no correspondence found"))
    claims.append((f"{total['points_lost']:,}", f"points lost of {total['points_in']:,}"))
    if total.get("bytes_saved") is not None:
        how = "" if total["savings_measured"] else " (estimated)"
        dropped = f"saved by leaving out {total['points_dropped_movable']:,} movable points{how}"
        claims.append((f"{total['bytes_saved'] / 1e3:,.0f} kB", dropped))
    if total["encode_ms_per_scan"] is not None:
        claims.append((f"{total['encode_ms_per_scan']:.0f} ms", "CPU to encode a scan"))
    if total["decode_ms_per_scan"] is not None:
        claims.append((f"{total['decode_ms_per_scan']:.0f} ms", "CPU to decode a scan"))
    return claims
