"""Damage the input of every reader and see it refused: ``python tests/fuzz [--count 50000] [--seed 0] [--only NAME]``.

Damaged input must be refused with an error of ours, or read as what it is; what a checksum guards must be
what was written. Anything else, more than five seconds, more than a gigabyte, or a process that dies, is a
failure. Each reader is fuzzed in a process of its own.
"""

from __future__ import annotations

import argparse
import faulthandler
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from target import Target, Wrong

from salpcc.schemas.errors import SalpccError

LONGEST = 5.0  # seconds for one input
MEMORY = 1 << 30  # bytes that a reader may ask for


def targets() -> dict[str, Target]:
    """All readers, by name."""
    import containers
    import files
    import logs
    import payloads
    import weights

    return {**payloads.TARGETS, **containers.TARGETS, **files.TARGETS, **logs.TARGETS, **weights.TARGETS}


def fuzz(name: str, count: int, seed: int, memory: int | None = MEMORY) -> str | None:
    """Fuzz one reader, with so many bytes for it besides what this process has; returns what went wrong."""
    target = targets()[name]
    rng = np.random.default_rng([seed, *name.encode()])
    tally: Counter[str] = Counter()
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        corpus = target.inputs(Path(folder))
        for which, data in enumerate(corpus):  # whole input is read, and kernels are compiled
            target.read(which, data, Path(folder))
        if memory is not None:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
        for i in range(count):
            which = i % len(corpus)
            damaged = target.mutate(corpus[which], rng)
            faulthandler.dump_traceback_later(LONGEST * 10, exit=True)  # of a hang in compiled code
            start = time.process_time()
            try:
                target.read(which, damaged, Path(folder))
            except SalpccError as error:
                tally[type(error).__name__] += 1
            except Exception as error:  # noqa: BLE001 (whatever it is, it is no refusal)
                kept = Path(tempfile.gettempdir()) / f"fuzz-{seed}-{i}"
                kept.write_bytes(damaged)
                wrong = "" if isinstance(error, Wrong) else f"{type(error).__name__}: "
                return f"{name}: mutation {i} (kept as {kept}): {wrong}{error}"
            else:
                tally["read"] += 1
            slowest = max(slowest, time.process_time() - start)
            if slowest > LONGEST:
                return f"{name}: mutation {i} took {slowest:.1f} s"
    faulthandler.cancel_dump_traceback_later()
    outcomes = ", ".join(f"{times} {outcome}" for outcome, times in sorted(tally.items()))
    print(f"{name}: {count} mutations, slowest {slowest:.2f} s: {outcomes}", flush=True)
    return None


def main() -> int:
    parser = argparse.ArgumentParser(prog="tests/fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="the name of one reader, which gets all mutations")
    arguments = parser.parse_args()
    if arguments.only:
        wrong = fuzz(arguments.only, arguments.count, arguments.seed)
        if wrong:
            print(wrong, file=sys.stderr)
        return 1 if wrong else 0
    all_of_them = targets()
    total, failed = sum(target.share for target in all_of_them.values()), []
    done = 0
    for name, target in all_of_them.items():
        count = -int(-arguments.count * target.share // total)
        command = [sys.executable, str(Path(__file__).parent), "--only", name, "--seed", str(arguments.seed)]
        end = subprocess.run([*command, "--count", str(count)], check=False).returncode
        done += count
        if end:
            failed.append(f"{name} (exit {end})")
    print(
        f"{done} mutations, {len(all_of_them)} readers: {'failed: ' + ', '.join(failed) if failed else 'passed'}"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
