"""Write more golden archives, ``nets/``: the paper profile with each of its coders, and every form of points off the lattice.

Run it by hand, and only when the format changes (schemas/ARCHIVE.md, section 8)::

    python tests/golden/make_golden_nets.py

``expected.json`` holds the SHA-256 of what each scan decodes to.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
from make_golden import FOLDER as GOLDEN
from make_golden import digests
from numpy.typing import NDArray

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.schemas.config import Coder
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.list_motion import places, redo
from salpcc.stages.lattice.sensor_model import SensorModel

FOLDER = GOLDEN / "nets"
LASERS, COLUMNS = 8, 300
MOTION = np.array([-0.5, 0.01, 0.01, 1e-3, -5e-4, 3e-3])


def fan() -> SensorModel:
    """A sensor whose files no coder of its own knows: 8 lasers, 1 mm counts."""
    none, rng = np.zeros(LASERS), np.random.default_rng(0)
    theta = np.radians(np.linspace(15, -15, LASERS))
    return SensorModel(
        "fan", 1800, 0.001, theta, none + 0.03, rng.normal(0, 1e-3, LASERS), none, none, none.astype(np.int64)
    )


def strays() -> dict[str, NDArray[np.float32]]:
    """Points ``(N, 3)`` by what they are: each takes another way through the coder."""
    sensor, rng = fan(), np.random.default_rng(1)
    laser = np.repeat(np.arange(LASERS), COLUMNS)
    tick = np.tile(np.arange(COLUMNS) * 6, LASERS)
    far = np.minimum(12.0 + tick // 400 * 2.0, 1.7 / np.maximum(-np.sin(sensor.theta[laser]), 0.02))
    count = np.rint((far + rng.normal(0, 0.01, len(tick))) / sensor.count)
    still = unproject(sensor, laser.astype(np.uint8), tick.astype(np.int32), count)
    rows = still.astype(np.float32)
    firings = rows.reshape(LASERS, COLUMNS, 3).transpose(1, 0, 2).reshape(-1, 3).copy()
    seen = rng.random(len(rows)) < 0.8
    void = np.where(seen[:, None], firings, 0).astype(np.float32)
    half = firings + np.where(seen, 0.0, rng.normal(0, 0.3, len(rows)))[:, None].astype(np.float32)
    odd = firings.copy()
    odd[5:9] = [[np.nan] * 3, [np.inf, 0, 1], [0, 0, 3], [-0.0, 0, 0]]
    moved = redo(firings.astype(np.float64), places(len(firings), LASERS), MOTION)
    return {
        "rows": rows,
        "rows of another sensor": rows * np.float32(1.01),
        "firings": firings,
        "returns": firings[seen],
        "void": void,
        "millimetres": (np.rint(firings * 1000.0) / 1000.0).astype(np.float32),
        "half": half,
        "odd": odd,
        "moved": moved.astype(np.float32),
        "noise": rng.normal(0, 20, (800, 3)).astype(np.float32),
        "noise in millimetres": rng.integers(-20_000, 20_000, (800, 3)).astype(np.float32) / np.float32(1000),
        "few": rng.normal(0, 20, (7, 3)).astype(np.float32),
        "none": np.zeros((0, 3), np.float32),
    }


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    with Archive.open(GOLDEN / "fast_exact.mcap") as archive:
        sweeps = [scan for scan in archive if scan.classes is not None]
    finite = [
        np.isfinite(scan.points).all(axis=1) & (np.abs(scan.points) < 1e5).all(axis=1) for scan in sweeps
    ]
    scans = [
        replace(s, points=s.points[f], intensity=s.intensity[f], classes=s.classes[f], motion=None)  # type: ignore[index]
        for s, f in zip(sweeps, finite, strict=True)
    ]
    for coder in get_args(Coder):
        for kept in (True, False) if coder == "ppmd" else (True,):
            name = f"paper_{coder}{'' if kept else '_dropped'}"
            options = {"profile": "paper", "coder": coder, "labels": "given", "max_error": 0.005}
            encode_scans(
                scans, FOLDER / f"{name}.mcap", "golden", overwrite=True, keep_movable=kept, **options
            )
    with TemporaryDirectory() as folder:
        sensor = Path(folder) / "fan.json"
        sensor.write_text(fan().to_json())
        rng = np.random.default_rng(2)
        listed = [
            Scan(name, points, (rng.integers(0, 256, len(points))).astype(np.float32), 10**8 * at)
            for at, (name, points) in enumerate(strays().items())
        ]
        for label, max_error in (("exact", None), ("10mm", 0.01), ("50mm", 0.05)):
            options = {"sensor": str(sensor), "effort": "fast", "max_error": max_error, "gop": 4}
            encode_scans(listed, FOLDER / f"strays_{label}.mcap", "golden", overwrite=True, **options)
    expected = {path.name: digests(path) for path in sorted(FOLDER.glob("*.mcap"))}
    (FOLDER / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
