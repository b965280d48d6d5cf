"""The scan to turn: what is packed is what was decoded. A browser draws it in test_report.py."""

import base64
import json
import zlib
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from salpcc.schemas.labels import CLASSES
from salpcc.stages.evaluate.report.layout.scene import Scene, scene_of
from salpcc.stages.evaluate.report.schema import METRICS


def sampled(n: int, **more: Any) -> pa.Table:
    rng = np.random.default_rng(0)
    angle = np.linspace(0, 40 * np.pi, n)
    points = np.column_stack([20 * np.cos(angle), 20 * np.sin(angle), rng.uniform(-2, 3, n)]).astype(
        np.float32
    )
    if n > 5:
        points[5] = np.nan
    row = {
        "sequence": "04",
        "name": "000007",
        "sample_points": points.ravel(),
        "sample_intensity": rng.random(n).astype(np.float32),
        "sample_error_m": np.zeros(n, np.float32),
        "sample_classes": rng.choice([1, 9, 15], n).astype(np.uint8),
        **more,
    }
    return pa.Table.from_pylist([{"sequence": "03"}, row], METRICS)


def unpacked(scene: Scene) -> tuple[dict[str, Any], np.ndarray, bytes]:
    told = json.loads(scene.data)
    plain = zlib.decompress(base64.b64decode(told["data"]))
    steps = np.frombuffer(plain, "<i2", 3 * told["points"]).reshape(3, -1)
    places = np.cumsum(steps, axis=1, dtype=np.int64).astype(np.int16)  # what wraps comes back
    return told, places.T / 100, plain[6 * told["points"] :]


def test_what_is_packed_is_the_scan() -> None:
    metrics = sampled(1000)
    scene = scene_of(metrics)
    assert scene is not None and scene.title == "Scan 04/000007 in 3-D"
    told, places, rest = unpacked(scene)
    points = np.array(metrics.column("sample_points")[1].as_py()).reshape(-1, 3)
    sound = np.isfinite(points).all(axis=1)
    assert told["points"] == 999 and np.abs(places - points[sound]).max() <= 0.005001
    assert [column["name"] for column in told["columns"]] == [
        "intensity"
    ]  # without an error there is none to show
    assert told["classes"] == {str(c): [CLASSES[c].name, list(CLASSES[c].colour)] for c in (1, 9, 15)}
    classes = np.array(metrics.column("sample_classes")[1].as_py(), np.uint8)[sound]
    assert rest[999:] == classes.tobytes()


@pytest.mark.filterwarnings("error")
def test_large_scans_are_thinned_and_others_left_out() -> None:
    scene = scene_of(sampled(90_000, sample_error_m=np.linspace(0, 0.01, 90_000).astype(np.float32)))
    assert scene is not None and "30,000 of its 90,000 points" in scene.caption
    told, _, _ = unpacked(scene)
    assert told["columns"][1] == {
        "name": "error",
        "unit": "mm",
        "low": 0.0,
        "high": pytest.approx(9.9, abs=0.01),
    }
    assert len(scene.data) < 600_000
    assert scene_of(sampled(0)) is None and scene_of(METRICS.empty_table()) is None
    far = scene_of(sampled(3, sample_points=[400.0, -400, 0, -400, 400, 0, 3e38, 0, 0]))
    assert far is not None and (unpacked(far)[1] == [[320, -320, 0], [-320, 320, 0], [320, 0, 0]]).all()
