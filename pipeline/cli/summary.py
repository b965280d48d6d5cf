"""What a run gave, in a few lines for the screen: how much smaller, how exact, what is kept, how long, where it lies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from statistics import median
from typing import Any

from rich.filesize import decimal


def smaller(raw: int, coded: int) -> str:
    """How many times smaller an archive is than the bytes of its points in the source, and both sizes."""
    return f"{raw / coded if coded else 0:.1f} : 1, {decimal(raw)} to {decimal(coded)}"


def summary(sequences: Iterable[dict[str, Any]], seconds: float) -> Iterator[str]:
    """Yield the lines about the sequences of one run.

    Args:
        sequences: their figures, as in report.json.
        seconds: that the run took.
    """
    figures = list(sequences)

    def total(key: str) -> int:
        return sum(one[key] for one in figures)

    points, scans, exact = total("points_in"), total("frames"), total("bit_exact_scans")
    coded = sum(one["bytes"]["total"] for one in figures)
    if not points:
        yield f"{scans} scans without a point, {decimal(coded)}"
        return
    yield f"{smaller(total('bytes_source'), coded)}, {8 * coded / points:.2f} bits a point"
    errors = [one["max_error_m"] for one in figures if one["max_error_m"] is not None]
    if exact == scans:
        yield "every bit of every point that is kept came back"
    elif errors:
        yield f"no point came back farther than {1e3 * max(errors):.2f} mm from its source"
    dropped, lost = total("points_dropped_movable"), total("points_lost")
    kept = (
        f"{points:,} points, all kept" if not dropped + lost else f"{points - dropped - lost:,} points kept"
    )
    kept += f", {dropped:,} that can move dropped ({100 * dropped / points:.1f} %)" if dropped else ""
    yield kept + (f", {lost:,} lost in the grid ({100 * lost / points:.1f} %)" if lost else "")
    kinds = {one.get("movable") for one in figures}
    if len(kinds) == 1 and (kind := kinds.pop()):
        yield layers_in_words(kind, _together(figures))
    yield from _beside(figures)
    yield f"{scans:,} scans in {seconds:.1f} s, {scans / seconds:.3g} a second, with all that is around the codec"
    code, back = (
        [one[key] for one in figures if one[key] is not None]
        for key in ("encode_ms_per_scan", "decode_ms_per_scan")
    )
    if code and back:
        yield f"the codec on one core: {median(code):.0f} ms to code a scan, {median(back):.0f} ms to decode it"


def _beside(figures: list[dict[str, Any]]) -> Iterator[str]:
    """Say what the archives hold besides points; its bytes are not among theirs."""
    found = [(one["labels"], one["side_files"]) for one in figures if one.get("labels")]
    scans, labels, files, side = (
        sum(pair[place][key] for pair in found)
        for place, key in ((0, "scans"), (0, "bytes"), (1, "files"), (1, "bytes"))
    )
    said = [f"labels of {scans:,} scans, {decimal(labels)}"] if scans else []
    said += [f"{files:,} side files, {decimal(side)}"] if files else []
    if said:
        yield f"beside the points: {'; '.join(said)}"


def _together(figures: list[dict[str, Any]]) -> dict[str, dict[str, int]] | None:
    """Points and bytes of each layer of all sequences."""
    found = [one["layers"] for one in figures if one["layers"]]
    return {
        name: {key: sum(layers[name][key] for layers in found) for key in ("points", "bytes")}
        for name in (found[0] if found else ())
    } or None


def layers_in_words(movable: str, layers: dict[str, dict[str, int]] | None) -> str:
    """Say what became of what can move: kept, layered, dropped."""
    if layers is None:
        return "kept: everything in one layer"
    sizes = {name: f"{layer['points']:,} points, {decimal(layer['bytes'])}" for name, layer in layers.items()}
    if movable == "layered":
        return f"layered: static {sizes['static']}; movable {sizes['movable']}"
    return f"dropped: what can move; static {sizes['static']}"
