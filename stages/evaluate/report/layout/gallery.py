"""The galleries of a report: decoded scans, segmentation beside its truth (Fig. 7), pictures of maps (Fig. 10)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from salpcc.schemas.shards import list_array
from salpcc.stages.evaluate.report.layout.pictures import (
    Picture,
    as_uri,
    scan_pictures,
    segmentation_pictures,
)

_PICTURED = 4  # sequences; more would only make the page heavy
_FIGURES = {"fig7": "Segmentation, further pictures (Fig. 7)", "fig10": "Maps, before and after (Fig. 10)"}


@dataclass(frozen=True)
class Gallery:
    """Pictures under one heading, in groups of their own headings; the first group is shown unfolded."""

    title: str
    note: str
    groups: Mapping[str, list[Picture]]


def galleries(metrics: pa.Table, drawn: pa.Table) -> list[Gallery]:
    """Everything there is to see in METRICS samples and in PICTURES that other commands drew."""
    found = [
        Gallery(
            "What comes back",
            "The first scan of the first sequences, as the archive decodes it.",
            _scans(metrics),
        ),
        Gallery(
            "Segmentation (Fig. 7)",
            "The first scan of the first sequences: pink is ground, blue is movable, grey is everything else, dark grey has no label.",
            _segmentations(metrics),
        ),
    ]
    for figure in dict.fromkeys(drawn.column("figure").to_pylist()):
        rows = drawn.filter(pc.equal(drawn.column("figure"), figure)).to_pylist()
        groups: dict[str, list[Picture]] = {}
        for row in rows:
            shot = Picture(row["title"], row["caption"], as_uri(row["png"]), _is_wide(row["png"]))
            groups.setdefault(f"Sequence {row['group']}", []).append(shot)
        found.append(Gallery(_FIGURES.get(figure, figure), "", groups))
    return [gallery for gallery in found if gallery.groups]


def _scans(metrics: pa.Table) -> dict[str, list[Picture]]:
    samples = _samples(metrics, "sample_points")
    pictures = {}
    for row in range(samples.num_rows):
        sequence, name = (samples.column(key)[row].as_py() for key in ("sequence", "name"))
        points, error = (list_array(samples, key, row) for key in ("sample_points", "sample_error_m"))
        assert points is not None and error is not None
        classes = list_array(samples, "sample_classes", row)
        pictures[f"Sequence {sequence}"] = scan_pictures(
            f"{sequence}/{name}", points.reshape(-1, 3), error, classes
        )
    return pictures


def _segmentations(metrics: pa.Table) -> dict[str, list[Picture]]:
    samples = _samples(metrics, "sample_predicted")
    pictures = {}
    for row in range(samples.num_rows):
        sequence, name = (samples.column(key)[row].as_py() for key in ("sequence", "name"))
        keys = ("sample_source", "sample_truth", "sample_predicted")
        points, truth, predicted = (list_array(samples, key, row) for key in keys)
        assert points is not None and truth is not None and predicted is not None
        pictures[f"Sequence {sequence}"] = segmentation_pictures(
            f"{sequence}/{name}", (points.reshape(-1, 3) / 100).astype(np.float32), truth, predicted
        )
    return pictures


def _samples(metrics: pa.Table, column: str) -> pa.Table:
    """The rows of the first few sequences that have a sample."""
    return metrics.filter(pc.is_valid(metrics.column(column))).sort_by("sequence").slice(0, _PICTURED)


def _is_wide(png: bytes) -> bool:
    """Tell from the header of a PNG whether it wants the whole width of the page."""
    width, height = struct.unpack_from(">II", png, 16)
    return bool(width > 2 * height)
