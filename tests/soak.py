"""Many scans through the whole graph: ``python tests/soak.py [--scans 2000] [--scaling 800] [--data ROOT]``.

Half of the scans are recorded ones (simulated ones where there are none) with returns left out at random and
intensities off by 0.01 at random, so that no two are alike; half are simulated. Prints throughput, memory
over time, what one and two workers cost, what the scheduler costs, and what 20,351 scans would cost.
Fails where memory grows or a scan is not bit-exact.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import psutil

from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.schemas.config import RunConfig
from salpcc.stages.ingest.sources.simulated import Simulated

GOP = 8
TEST_SCANS = 20_351  # sequences 11 to 21 of SemanticKITTI
GROWTH = 1.15  # memory at the end over memory after the first third


@dataclass
class Use:
    """What a run used: seconds of CPU in this process (scheduler and client) and in workers, memory over time."""

    wall: float = 0.0
    scheduler: float = 0.0
    workers: float = 0.0
    rss: list[float] = field(default_factory=list)  # MB, all processes


def watch(use: Use, stop: threading.Event) -> None:
    """Sample until told to stop. CPU of workers that end is that of their last sample."""
    own, begun = psutil.Process(), time.perf_counter()
    before, spent = sum(own.cpu_times()[:2]), {}
    while not stop.wait(0.5):
        rss = own.memory_info().rss
        for child in own.children(recursive=True):
            try:
                spent[child.pid] = sum(child.cpu_times()[:2])
                rss += child.memory_info().rss
            except psutil.Error:
                continue
        use.rss.append(rss / 2**20)
        use.wall, use.workers = time.perf_counter() - begun, sum(spent.values())
        use.scheduler = sum(own.cpu_times()[:2]) - before


def make(root: Path, scans: int, data: Path | None) -> int:
    """Write ``scans`` scans as sequences 00 (recorded, varied) and 01 (simulated); returns their bytes."""
    half = scans // 2
    rng = np.random.default_rng(0)
    recorded = sorted((data / "sequences").glob("*/velodyne/*.bin")) if data is not None else []
    few = [Path(ref.path) for ref in Simulated().make(root / "made", "01", 16)]
    for sequence, sources, count in (("00", recorded or few, half), ("01", few, scans - half)):
        folder = root / "sequences" / sequence / "velodyne"
        folder.mkdir(parents=True)
        for number in range(count):
            rows = np.fromfile(sources[number % len(sources)], "<f4").reshape(-1, 4)
            rows = rows[rng.random(len(rows)) < 0.98]
            hundredths = np.rint(rows[:, 3] * 100) + rng.integers(-1, 2, len(rows))
            rows[:, 3] = (np.clip(hundredths, 0, 99) / 100).astype(np.float32)
            rows.tofile(folder / f"{number:06d}.bin")
    return sum(path.stat().st_size for path in (root / "sequences").rglob("*.bin"))


def go(root: Path, out: Path, workers: int, scans: int) -> Use:
    """Run everything at effort fast, watched; every scan must come back bit for bit."""
    use, stop = Use(), threading.Event()
    watcher = threading.Thread(target=watch, args=(use, stop))
    watcher.start()
    config = RunConfig(effort="fast", gop=GOP, keep_movable=True)
    result = run_sequences(RunRequest(config, ["00", "01"], out, root, workers, quiet=True))
    stop.set()
    watcher.join()
    assert not result.failed and result.report is not None
    exact = sum(figures["bit_exact_scans"] for figures in result.report["sequences"].values())
    if exact != scans:
        sys.exit(f"{exact} of {scans} scans are bit-exact")
    return use


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=2000)
    parser.add_argument("--scaling", type=int, default=800, help="scans for one against two workers; 0: not")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--data", type=Path, help="root of recorded scans, in SemanticKITTI's layout")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        root = Path(folder)
        size = make(root / "all", arguments.scans, arguments.data)
        print(
            f"{arguments.scans} scans, {size / 1e9:.2f} GB, effort fast, GOPs of {GOP}; load {os.getloadavg()[0]:.1f}"
        )
        use = go(root / "all", root / "out", arguments.workers, arguments.scans)
        per_scan = use.workers / arguments.scans
        overhead = use.scheduler / -(-arguments.scans // GOP)
        third, end = max(use.rss[len(use.rss) // 6 : len(use.rss) // 3]), max(use.rss[-len(use.rss) // 3 :])
        print(
            f"{arguments.workers} workers: {use.wall:.0f} s wall, {arguments.scans / use.wall:.2f} scans/s, {size / 1e6 / use.wall:.1f} MB/s"
        )
        print(
            f"CPU: {1e3 * per_scan:.0f} ms a scan in workers, {1e3 * overhead:.1f} ms a GOP in scheduler, client and report"
        )
        print(
            "memory of all processes over the run, MB: "
            + " ".join(f"{max(part):.0f}" for part in np.array_split(use.rss, 12))
        )
        print(f"at the end {end / third:.2f} times that of the second sixth")
        if arguments.scaling:
            scaling(root, arguments.scaling, arguments.data)
        print("cores   hours (workers)   hours (scheduler)      for 20,351 scans, on paper")
        for cores in (1, 16, 256):
            print(
                f"{cores:5d} {TEST_SCANS * per_scan / cores / 3600:17.2f} {TEST_SCANS / GOP * overhead / 3600:19.2f}"
            )
    return 0 if end <= GROWTH * third else 1


def scaling(root: Path, scans: int, data: Path | None) -> None:
    """One worker against two, on the same scans."""
    make(root / "some", scans, data)
    one, two = (go(root / "some", root / f"out{n}", n, scans) for n in (1, 2))
    print(
        f"1 worker: {one.wall:.0f} s wall, {1e3 * one.workers / scans:.0f} ms CPU a scan; 2 workers: {two.wall:.0f} s wall, {1e3 * two.workers / scans:.0f} ms CPU a scan"
    )
    print(
        f"scaling by wall {one.wall / two.wall:.2f} (load now {os.getloadavg()[0]:.1f}), by CPU {2 * one.workers / two.workers:.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())
