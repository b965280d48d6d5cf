"""Mutate payloads and see them refused: ``python tests/fuzz.py [--count 20000] [--seed 0]``.

Every mutation keeps or repairs the outer checksum as chance has it, so that half of them reach the
kernels. A mutation must be refused with an ArchiveError or decode to the very same scan (where it
changed nothing that counts); anything else, and any decode longer than five seconds, is a failure.
"""

from __future__ import annotations

import argparse
import sys
import time
import zlib
from collections import Counter

import numpy as np

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.lattice import unproject
from salpcc.stages.ingest.order import azimuth_keys
from salpcc.stages.ingest.sensor_model import SensorModel, load_sensor
from salpcc.stages.ingest.sweep import scan_to_sweep
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.payload import EFFORTS, content_crc
from salpcc.stages.segment.task import quantise

LONGEST = 5.0  # seconds


def small_scan(sensor: SensorModel, rng: np.random.Generator) -> Scan:
    """A room of a few thousand returns, with strays."""
    firings = np.arange(0, sensor.ticks_per_turn, 40)
    laser = np.repeat(np.arange(sensor.n_lasers), len(firings))
    tick = ((np.tile(firings, sensor.n_lasers) + sensor.shift[laser]) % sensor.ticks_per_turn).astype(
        np.int32
    )
    count = (3000 + 500 * np.sin(tick / 200) + rng.normal(0, 5, len(tick))).astype(np.int32)
    model = unproject(sensor, laser.astype(np.uint8), tick, count)
    order = np.lexsort((azimuth_keys(model), laser))
    points = (np.rint(model[order] * 1000) / 1000).astype(np.float32)
    points[:20] = rng.normal(0, 5, (20, 3))
    return Scan("0", points, (rng.integers(0, 101, len(points)) / 100).astype(np.float32), classes=None)


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One of: flipped bits, random bytes, a cut, an insertion, a changed header."""
    body = bytearray(data[:-4])
    kind = rng.integers(0, 5)
    if kind == 0:
        for bit in rng.integers(0, 8 * len(body), rng.integers(1, 9)):
            body[bit // 8] ^= 1 << (bit % 8)
    elif kind == 1:
        at = int(rng.integers(0, len(body)))
        body[at : at + 16] = rng.bytes(len(body[at : at + 16]))
    elif kind == 2:
        body = body[: rng.integers(0, len(body))]
    elif kind == 3:
        at = int(rng.integers(0, len(body)))
        body[at:at] = rng.bytes(int(rng.integers(1, 40)))
    else:
        body[int(rng.integers(0, min(100, len(body))))] = int(rng.integers(0, 256))
    if rng.random() < 0.5:
        return bytes(body) + zlib.crc32(body).to_bytes(4, "little")
    return bytes(body) + data[-4:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    sensor = load_sensor("hdl64e")
    sweep = scan_to_sweep(small_scan(sensor, rng), sensor)
    corpus = []
    for task in (sweep, quantise(sweep, sensor, 0.01)):
        for effort in EFFORTS:
            corpus.append((effort, encode_gop([task], sensor, effort)[0].data, content_crc(task)))
    tally: Counter[str] = Counter()
    slowest = 0.0
    for i in range(arguments.count):
        effort, data, crc = corpus[i % len(corpus)]
        damaged = mutate(data, rng)
        start = time.perf_counter()
        try:
            (back,) = decode_gop([damaged], sensor)
        except ArchiveError as error:
            tally[f"{effort}: {str(error).split(' (')[0].split(' the weights')[0]}"] += 1
        else:
            if content_crc(back) != crc:
                print(f"mutation {i} decoded to something else without a word", file=sys.stderr)
                return 1
            tally[f"{effort}: the same scan"] += 1
        taken = time.perf_counter() - start
        slowest = max(slowest, taken)
        if taken > LONGEST and i >= len(corpus):
            print(f"mutation {i} took {taken:.1f} s", file=sys.stderr)
            return 1
    for outcome, times in sorted(tally.items()):
        print(f"{times:7d}  {outcome}")
    print(f"{arguments.count} mutations passed, slowest decode {slowest:.2f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
