"""Encode scans that you have as arrays, and get them back: ``python examples/encode_arrays.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from salpcc import Archive, Scan, encode_scans


def main() -> None:
    """Encode two random clouds bit-exactly and within 1 cm."""
    random = np.random.default_rng(0)
    scans = [
        Scan(
            name=f"{number:06d}",
            points=random.normal(0, 10, (2000, 3)).astype(np.float32),
            intensity=random.random(2000).astype(np.float32),
            time=number * 100_000_000,
        )
        for number in range(2)
    ]
    with tempfile.TemporaryDirectory() as folder:
        for error in (None, 0.01):
            path = encode_scans(scans, Path(folder) / f"{error}.mcap", max_error=error)
            with Archive.open(path) as archive:
                worst = max(
                    float(np.linalg.norm(scan.points - source.points, axis=1).max())
                    for scan, source in zip(archive, scans, strict=True)
                )
            print(f"max_error {error}: {path.stat().st_size} bytes, largest error {worst:.4f} m")


if __name__ == "__main__":
    main()
