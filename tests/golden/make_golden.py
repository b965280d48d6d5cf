"""Write the golden archives: tiny ones of this codec version, and what they must decode to.

Run it by hand, and only when the codec version or the learned weights change (schemas/ARCHIVE.md, section 8)::

    python tests/golden/make_golden.py

It replaces everything in its folder: ``input.npz`` (the points that went in, so that no test makes them again
with another machine's sine), six archives ``EFFORT_exact.mcap`` and ``EFFORT_10mm.mcap``, and ``expected.json``
with the SHA-256 of what each scan decodes to.
"""

from __future__ import annotations

import json
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.lattice.untwist import twist
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import encode_gop
from salpcc.stages.residual_code.sensor.header import CODEC_VERSION, EFFORTS
from salpcc.stages.segment.task import quantise

FOLDER = Path(__file__).parent
MOTION = np.array([-1.2, 0.02, -0.01, 5e-4, 1e-3, -8e-3])
ERRORS = {"exact": 0.0, "10mm": 0.01}


def street(sensor: SensorModel, seed: int, firings: int, motion: NDArray[np.float64] | None) -> Scan:
    """Make a thin scan of ground and walls, with points that no lattice has: far, NaN, twice, out of place."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(0, sensor.ticks_per_turn, sensor.ticks_per_turn // firings)
    laser = np.repeat(np.arange(sensor.n_lasers), len(ticks))
    tick = (np.tile(ticks, sensor.n_lasers) + sensor.shift[laser]) % sensor.ticks_per_turn
    wall = 12.0 + 6.0 * np.sin(tick / 4000 * 6 * np.pi + seed) + (tick // 300 % 2) * 3.0
    ground = 1.73 / np.maximum(-np.sin(sensor.theta[laser]), 0.02)
    distance = np.minimum(wall, ground) + rng.normal(0, 0.01, len(tick))
    count = np.rint((distance - sensor.d0[laser]) / sensor.count)
    seen = rng.random(len(tick)) < 0.9
    laser, tick, count = laser[seen], tick[seen], count[seen]
    model = unproject(sensor, laser.astype(np.uint8), tick.astype(np.int32), count)
    order = np.lexsort((azimuth_keys(model), laser))
    raw = (np.rint(model[order] * 1000) / 1000).astype(np.float32)
    points = raw if motion is None else twist(raw.astype(np.float64), motion).astype(np.float32)
    classes = np.where(ground[seen][order] < wall[seen][order], 9, 13).astype(np.uint8)
    classes[rng.random(len(classes)) < 0.02] = 1
    n = len(points)
    points[n // 7] = np.nan
    points[n // 5] = points[n // 5 - 1]
    points[n // 3] = [1e6, -0.0, np.inf]
    points[n // 2] = points[40]
    points[-3:] += np.float32(0.0004)
    intensity = ((20 + 10 * np.sin(laser[order] / 5) + rng.integers(0, 8, n)).astype(int) / 100).astype("f4")
    return Scan(f"{seed:06d}", points, intensity, 10**8 * seed, "velodyne", classes)


def scans(sensor: SensorModel) -> list[list[Scan]]:
    """Two GOPs: two scans with classes; one raw scan whose intensities are not hundredths, without."""
    pair = [street(sensor, seed, 50, MOTION * (1.0 + 0.005 * seed)) for seed in (0, 1)]
    raw = street(sensor, 2, 25, None)
    odd = raw.intensity.copy()
    odd[::5] += np.float32(1e-4)
    return [pair, [Scan(raw.name, raw.points, odd, raw.time, raw.frame_id)]]


def digests(path: Path) -> dict[str, dict[str, str | int]]:
    """What the scans of an archive decode to: number and SHA-256 of points, intensities and classes."""
    with Archive.open(path) as archive:
        return {
            scan.name: {
                "points": sha256(scan.points.astype("<f4").tobytes()).hexdigest(),
                "intensity": sha256(scan.intensity.astype("<f4").tobytes()).hexdigest(),
                "classes": "" if scan.classes is None else sha256(scan.classes.tobytes()).hexdigest(),
                "n": len(scan),
            }
            for scan in archive
        }


def write(path: Path, gops: list[list[Scan]], sensor: SensorModel, effort: str, max_error: float) -> None:
    """Encode scans to an archive; thin as they are, their motion is found from close by only."""
    coded = []
    for gop in gops:
        sweeps = []
        for scan in gop:
            sweep = scan_to_sweep(scan, sensor, MOTION)
            if len(sweep.laser) < 0.9 * len(scan):
                sys.exit(f"scan {scan.name}: only {len(sweep.laser)} of {len(scan)} points are returns")
            sweeps.append(quantise(sweep, sensor, max_error) if max_error else sweep)
        coded.append(
            [
                ScanPayload(
                    ScanEntry(s.name, s.n_points, len(s), 0, len(s.stray_index), **payload.sizes),
                    s.time, s.frame_id, payload.data,
                )
                for s, payload in zip(sweeps, encode_gop(sweeps, sensor, effort), strict=True)
            ]
        )  # fmt: skip
    facts = ArchiveFacts("golden", "arrays", "", {"effort": effort, "max_error": max_error or None}, sensor)
    write_archive(path, facts, coded)


def main() -> None:
    sensor = load_sensor("hdl64e")
    gops = scans(sensor)
    arrays = {}
    for scan in (scan for gop in gops for scan in gop):
        arrays[f"points_{scan.name}"] = scan.points
        arrays[f"intensity_{scan.name}"] = scan.intensity
    np.savez_compressed(FOLDER / "input.npz", **arrays)
    expected = {}
    for effort in EFFORTS:
        for label, max_error in ERRORS.items():
            path = FOLDER / f"{effort}_{label}.mcap"
            write(path, gops, sensor, effort, max_error)
            expected[path.name] = digests(path)
            print(f"{path.name}: {path.stat().st_size} bytes")
    text = json.dumps({"codec_version": CODEC_VERSION, "archives": expected}, indent=1)
    (FOLDER / "expected.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
