"""Fail where LiDAR scans take more bits than they did, or do not come back: for continuous integration of any project.

    python check_bits.py                                   # two simulated scans
    python check_bits.py --root DIR --sequence 04          # the first two of yours, in SemanticKITTI's layout
    python check_bits.py --store                           # take what comes out as what is expected

It needs ``pip install 'salpcc-pipeline[run]'``, and less than a minute on two cores. The figures that are expected lie
beside this file, in ``expected_bits.json``: bits a point by sequence.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

EXPECTED = Path(__file__).with_name("expected_bits.json")
SCANS = 2


def tool(*arguments: object) -> str:
    """Run ``salpcc-pipeline``, and return what it prints; what it says besides goes to the log of the job."""
    command = [sys.executable, "-m", "salpcc.pipeline.cli", *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def measure(root: Path | None, sequence: str, out: Path) -> float:
    """Encode scans, compare every point with its source, and return the bits a point."""
    where = ["--root", root] if root else ["--source", "simulated"]
    options = ["--frames", f"0:{SCANS}", "--effort", "fast", "--keep-movable", "--workers", 0]
    report = json.loads(tool("run", "sequences", sequence, *where, *options, "--out", out, "--json"))
    source = root or out / "simulated"
    tool("verify", out / "archives" / f"{sequence}.mcap", "--against", source)
    return float(report["sequences"][sequence]["bpp"]["total"])


def main() -> int:
    """Compare with what is expected; the exit code is 1 where it is more."""
    parser = argparse.ArgumentParser(description="Fail where scans take more bits than they did.")
    parser.add_argument("--root", type=Path, help="recorded scans in SemanticKITTI's layout")
    parser.add_argument("--sequence", default="00", help="the one to take, such as 04")
    parser.add_argument("--expected", type=Path, default=EXPECTED, help="file of the stored figures")
    parser.add_argument("--allow", type=float, default=0.02, help="share by which it may grow")
    parser.add_argument("--store", action="store_true", help="store the figure instead of comparing it")
    options = parser.parse_args()
    key = f"{'recorded' if options.root else 'simulated'} {options.sequence}"
    stored = json.loads(options.expected.read_text()) if options.expected.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        bits = measure(options.root, options.sequence, Path(folder) / "out")
    if options.store:
        options.expected.write_text(json.dumps(stored | {key: round(bits, 3)}, indent=1) + "\n")
        print(f"{key}: {bits:.3f} bits a point, stored in {options.expected}")
        return 0
    if key not in stored:
        print(f"{key}: no figure in {options.expected}; store one with --store")
        return 1
    good = bits <= stored[key] * (1 + options.allow)
    print(
        f"{key}: {bits:.3f} bits a point, {stored[key]:.3f} expected: {'ok' if good else 'MORE THAN IT WAS'}"
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
