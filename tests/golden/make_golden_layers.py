"""Write golden archives of two layers, ``layers/``, and what they must decode to.

Run it by hand, and only when the format changes (schemas/ARCHIVE.md, section 8)::

    python tests/golden/make_golden_layers.py

``expected.json`` holds the SHA-256 of what each scan decodes to, by archive and layer.
"""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any

from make_golden import FOLDER as GOLDEN
from make_golden import street

from salpcc.pipeline import Archive, encode_scans
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.sensor_model import load_sensor

FOLDER = GOLDEN / "layers"
OPTIONS: dict[str, dict[str, Any]] = {
    "fast_exact": {"effort": "fast"},
    "default_exact": {"effort": "default"},
    "fast_20mm_5mm": {"effort": "fast", "max_error": 0.02, "movable_max_error": 0.005},
}


def digest(scan: Scan) -> str:
    """SHA-256 of points, intensities and classes."""
    assert scan.classes is not None
    parts = scan.points.astype("<f4"), scan.intensity.astype("<f4"), scan.classes
    return sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    sensor = load_sensor("hdl64e")
    scans = [street(sensor, seed, 40, None) for seed in (3, 4, 5)]
    for scan in scans:  # a car, and people where points are off the lattice
        assert scan.classes is not None
        n = len(scan)
        scan.classes[n // 4 : n // 4 + 200] = 1
        scan.classes[[n // 7, n // 3]] = 6
    expected: dict[str, Any] = {}
    for name, options in OPTIONS.items():
        path = FOLDER / f"{name}.mcap"
        encode_scans(
            scans, path, "golden", overwrite=True, labels="given", keep_movable=False, gop=2, **options
        )
        expected[path.name] = {
            layers: {scan.name: digest(scan) for scan in Archive.open(path, layers=layers)}  # type: ignore[arg-type]
            for layers in ("all", "static", "movable")
        }
        print(f"{path.name}: {path.stat().st_size} bytes")
    (FOLDER / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
