"""Write golden archives with labels and side files, ``labels/``, and what they must decode to.

Run it by hand, and only when the format changes (schemas/ARCHIVE.md, section 8)::

    python tests/golden/make_golden_labels.py

``expected.json`` holds the SHA-256 of the labels of each scan by archive and layer, and of each side file.
"""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from make_golden import FOLDER as GOLDEN
from make_golden import street

from salpcc.pipeline import Archive, encode_scans
from salpcc.schemas.labels import labels_of_classes
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.writer import write_archive

FOLDER = GOLDEN / "labels"
OPTIONS: dict[str, dict[str, Any]] = {
    "one_layer": {"keep_movable": True},
    "layered": {"keep_movable": False, "labels": "given"},
    "layered_20mm": {"keep_movable": False, "labels": "given", "max_error": 0.02},
}
SIDE = [SideFile("calib.txt", b"Tr: 1 0 0 0\n"), SideFile("oxts/data/0000000000.txt", b"49.0 8.4\n")]


def labelled(seed: int) -> Scan:
    """A street whose points have classes in runs, instances, and a few labels of their own."""
    scan = street(load_sensor("hdl64e"), seed, 40, None)
    rng = np.random.default_rng(seed)
    n = len(scan)
    classes = np.repeat(rng.choice(np.array([1, 9, 11, 13, 15], np.uint8), n // 50 + 1), 50)[:n]
    labels = labels_of_classes(classes) | np.where(classes == 1, np.arange(n) // 400 << 16, 0).astype(
        np.uint32
    )
    labels[rng.choice(n, 9, replace=False)] = rng.integers(0, 2**32, 9, np.uint32)
    return replace(scan, classes=classes, labels=labels)


def digests(path: Path) -> dict[str, Any]:
    """SHA-256 of the labels by layer and scan, and of the side files."""
    found: dict[str, Any] = {}
    for layers in ("all", "static", "movable") if ArchiveReader(path).facts.layers else ("all",):
        with Archive.open(path, layers=layers) as archive:  # type: ignore[arg-type]
            found[layers] = {}
            for scan in archive:
                assert scan.labels is not None
                found[layers][scan.name] = sha256(scan.labels.astype("<u4").tobytes()).hexdigest()
    found["side"] = {name: sha256(archive.side_file(name)).hexdigest() for name in archive.side}
    return found


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    expected = {}
    for name, options in OPTIONS.items():
        path = FOLDER / f"{name}.mcap"
        with TemporaryDirectory() as folder:
            reader = ArchiveReader(
                encode_scans(
                    [labelled(seed) for seed in (6, 7)],
                    Path(folder) / "a.mcap",
                    "golden",
                    effort="fast",
                    gop=2,
                    **options,
                )
            )
            gops = [
                [
                    replace(p, movable=m)
                    for p, m in zip(reader.payloads(0), reader.movable_payloads(0), strict=True)
                ]
                if reader.facts.layers
                else reader.payloads(0)
            ]
            write_archive(path, reader.facts, gops, side=SIDE)
        expected[path.name] = digests(path)
        print(f"{path.name}: {path.stat().st_size} bytes")
    (FOLDER / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
