"""Golden archives with labels and side files: every later version reads the same, and codes labels to the same bytes.

If a test here fails, the format changed (schemas/ARCHIVE.md, section 8): ``python tests/golden/make_golden_labels.py``.
"""

import json
from hashlib import sha256
from pathlib import Path

import pytest

from salpcc.pipeline.archive import Archive
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.gop import decode_gop
from salpcc.stages.residual_code.label_coder import decode_labels, encode_labels, labelled
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan

LABELS = Path(__file__).parents[2] / "golden" / "labels"
EXPECTED = json.loads((LABELS / "expected.json").read_text())


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_decodes_to_the_same(name: str) -> None:
    for layers, scans in EXPECTED[name].items():
        with Archive.open(LABELS / name, layers="all" if layers == "side" else layers) as archive:
            if layers == "side":
                assert {file: sha256(archive.side_file(file)).hexdigest() for file in archive.side} == scans
                continue
            assert {s.name: sha256(s.labels.astype("<u4").tobytes()).hexdigest() for s in archive} == scans


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_labels_encode_to_the_same_bytes(name: str) -> None:
    reader = ArchiveReader(LABELS / name)
    sensor, models = reader.facts.sensor, GopState(reader.facts.sensor)
    payloads = reader.payloads(0)
    layers = reader.movable_payloads(0) or [None] * len(payloads)
    for payload, layer, sweep in zip(
        payloads, layers, decode_gop((p.data for p in payloads), sensor), strict=True
    ):
        assert encode_labels(labelled(sweep, payload.labels, sensor), sensor) == payload.labels
        if layer is not None:
            movable = decode_scan(layer.data, sensor, models, sweep)
            assert encode_labels(labelled(movable, layer.labels, sensor), sensor) == layer.labels
            assert decode_labels(layer.labels, movable, sensor)[0].shape == movable.laser.shape
