"""Write the report as one HTML page that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined

from salpcc.stages.evaluate.layout.drawing import Plot
from salpcc.stages.evaluate.layout.pictures import Picture
from salpcc.stages.evaluate.layout.tables import Table


def render_page(
    report: Mapping[str, Any],
    tables: Sequence[Table],
    plots: Sequence[Plot],
    sequence_plots: Sequence[Plot],
    pictures: Mapping[str, Sequence[Picture]],
) -> str:
    """Fill ``page.html.j2``. ``pictures`` by sequence."""
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
        tables=tables,
        plots=plots,
        sequence_plots=sequence_plots,
        pictures=pictures,
    )


def headline(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The handful of figures that a reader looks for first, as (figure, what it is)."""
    total = report["total"]
    if not total["frames"]:
        return []
    claims = [
        (f"{total['compression_rate_percent']:.2f} %", "of the source size (16 B per point)"),
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
    if total["encode_ms_per_scan"] is not None:
        claims.append((f"{total['encode_ms_per_scan']:.0f} ms", "CPU to encode a scan"))
    if total["decode_ms_per_scan"] is not None:
        claims.append((f"{total['decode_ms_per_scan']:.0f} ms", "CPU to decode a scan"))
    return claims
