"""A decoded scan in 3-D on the page, to turn with the mouse: its points packed into text, drawn by ``scene.js``.

Points are whole centimetres, each column the differences from point to point, which deflate well. All else is a byte a point.
"""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES
from salpcc.schemas.shards import list_array

_MOST_POINTS = 40_000  # what of a scan is drawn: half a megabyte of the page
_FARTHEST = 320  # metres; centimetres are stored in 16 bits


@dataclass(frozen=True)
class Scene:
    """What is drawn: a title, a caption, and the JSON and the program that the page holds."""

    title: str
    caption: str
    data: str
    program: str


def scene_of(metrics: pa.Table) -> Scene | None:
    """Return the scene of the first scan that METRICS hold a sample of; None where there is none."""
    samples = metrics.filter(pc.is_valid(metrics.column("sample_points"))).sort_by("sequence").slice(0, 1)
    if not samples.num_rows:
        return None
    flat = list_array(samples, "sample_points", 0)
    assert flat is not None
    points = flat.reshape(-1, 3)
    sound = np.flatnonzero(np.isfinite(points).all(axis=1))
    chosen = sound[:: -(-len(sound) // _MOST_POINTS) or 1]
    if not len(chosen):
        return None
    cells = np.rint(100 * np.clip(points[chosen], -_FARTHEST, _FARTHEST)).astype(np.int64)
    columns = [np.diff(cells[:, axis], prepend=0).astype("<i2").tobytes() for axis in range(3)]
    told: dict[str, Any] = {"points": len(chosen), "columns": []}
    for name, unit, scale in (("intensity", "", 1.0), ("error_m", "mm", 1e3)):
        values = list_array(samples, f"sample_{name}", 0)
        if values is not None and np.ptp(values[chosen]):
            packed, low, high = _bytes(scale * values[chosen].astype(np.float64))
            told["columns"].append({"name": name.split("_")[0], "unit": unit, "low": low, "high": high})
            columns.append(packed)
    classes = list_array(samples, "sample_classes", 0)
    if classes is not None:
        columns.append(classes[chosen].astype(np.uint8).tobytes())
        here = sorted(set(classes[chosen].tolist()))
        told["classes"] = {c: [CLASSES[c].name, list(CLASSES[c].colour)] for c in here}
    told["data"] = base64.b64encode(zlib.compress(b"".join(columns), 9)).decode()
    name = f"{samples.column('sequence')[0].as_py()}/{samples.column('name')[0].as_py()}"
    few = f", {len(chosen):,} of its {len(points):,} points" if len(chosen) < len(points) else ""
    return Scene(
        f"Scan {name} in 3-D",
        f"As the archive decodes it{few}. Drag to turn, wheel or pinch to come nearer, Shift and drag to move.",
        json.dumps(told, separators=(",", ":")).replace("<", r"\u003c"),  # it stands in a page
        files(__package__).joinpath("scene.js").read_text(encoding="utf-8"),
    )


def _bytes(values: NDArray[np.float64]) -> tuple[bytes, float, float]:
    """Values as bytes, and what 0 and 255 stand for; the topmost hundredth is all 255."""
    values = np.nan_to_num(values)
    low, high = float(values.min()), float(np.percentile(values, 99)) or float(values.max())
    high = high if high > low else float(values.max())
    scaled = np.clip(np.rint(255 * (values - low) / (high - low)), 0, 255)
    return scaled.astype(np.uint8).tobytes(), low, high
