"""Golden archives of two layers: every later version reads the same bits of each layer, and writes the same payloads.

If a test here fails, the format changed (schemas/ARCHIVE.md, section 8): ``python tests/golden/make_golden_layers.py``.
"""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest

from salpcc.pipeline.archive import Archive
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import decode_gop, encode_layers
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan

LAYERS = Path(__file__).parents[2] / "golden" / "layers"
EXPECTED = json.loads((LAYERS / "expected.json").read_text())


def test_all_archives_are_there() -> None:
    assert sorted(path.name for path in LAYERS.glob("*.mcap")) == sorted(EXPECTED)


@pytest.mark.parametrize("layers", ["all", "static", "movable"])
@pytest.mark.parametrize("name", EXPECTED)
def test_decodes_to_the_same_bits(name: str, layers: str) -> None:
    told = {}
    for scan in Archive.open(LAYERS / name, layers=layers):  # type: ignore[arg-type]
        assert scan.classes is not None
        parts = scan.points.astype("<f4"), scan.intensity.astype("<f4"), scan.classes
        told[scan.name] = sha256(b"".join(part.tobytes() for part in parts)).hexdigest()
    assert told == EXPECTED[name][layers]


@pytest.mark.parametrize("name", EXPECTED)
def test_encodes_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    reader = ArchiveReader(LAYERS / name)
    sensor, gops = reader.facts.sensor, []
    for gop in range(len(reader.gops)):
        static, movable = reader.payloads(gop), reader.movable_payloads(gop)
        models, pairs = GopState(sensor), []
        for sweep, layer in zip(decode_gop((p.data for p in static), sensor), movable, strict=True):
            pairs.append((sweep, decode_scan(layer.data, sensor, models, sweep)))
        assert any(len(layer.laser) for _, layer in pairs) and any(len(p.stray_index) for _, p in pairs)
        again = encode_layers(pairs, sensor, reader.facts.config["effort"])
        assert [(a.data, b.data) for a, b in again] == [
            (a.data, b.data) for a, b in zip(static, movable, strict=True)
        ]
        gops.append([replace(a, movable=b) for a, b in zip(static, movable, strict=True)])
    write_archive(tmp_path / name, reader.facts, gops)
    assert (tmp_path / name).read_bytes() == (LAYERS / name).read_bytes()
