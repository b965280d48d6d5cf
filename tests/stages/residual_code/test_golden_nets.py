"""More golden archives: the paper profile with each coder, and every form of points off the lattice.

If a test here fails, the format changed (schemas/ARCHIVE.md, section 8): ``python tests/golden/make_golden_nets.py``.
"""

import json
from hashlib import sha256
from pathlib import Path

import pytest

from salpcc.pipeline.archive import Archive
from salpcc.stages.lists.list_coder import AIMED
from salpcc.stages.lists.rays.ray_forms import ALONG, BITS, GRID
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.sensor.payload import unpack

NETS = Path(__file__).parents[2] / "golden" / "nets"
EXPECTED = json.loads((NETS / "expected.json").read_text())
STRAYS = [name for name in EXPECTED if name.startswith("strays")]


def test_all_archives_are_there() -> None:
    assert sorted(path.name for path in NETS.glob("*.mcap")) == sorted(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_decodes_to_the_same_bits(name: str) -> None:
    with Archive.open(NETS / name) as archive:
        told = {
            scan.name: {
                "points": sha256(scan.points.astype("<f4").tobytes()).hexdigest(),
                "intensity": sha256(scan.intensity.astype("<f4").tobytes()).hexdigest(),
                "classes": "" if scan.classes is None else sha256(scan.classes.tobytes()).hexdigest(),
                "n": len(scan),
            }
            for scan in archive
        }
    assert told == EXPECTED[name]


@pytest.mark.parametrize("name", STRAYS)
def test_strays_encode_to_the_same_payloads(name: str) -> None:
    reader = ArchiveReader(NETS / name)
    for gop in range(len(reader.gops)):
        payloads = [payload.data for payload in reader.payloads(gop)]
        again = encode_gop(decode_gop(payloads, reader.facts.sensor), reader.facts.sensor, "fast")
        assert [payload.data for payload in again] == payloads


def test_every_form_is_there() -> None:
    """Points by their bits, on a grid, along rays and on the sensor's lattice; as a list, in firings and in lanes."""
    forms, layouts = set(), set()
    for name in STRAYS:
        reader = ArchiveReader(NETS / name)
        for payload in (p for gop in range(len(reader.gops)) for p in reader.payloads(gop)):
            stream = bytes(unpack(payload.data)[1]["stray_points"])
            if stream:
                forms.add(stream[4])
                layouts.add((min(stream[5], 2), min(stream[7], 2)))
    assert forms == {ALONG, GRID, BITS, AIMED}
    assert layouts >= {(1, 0), (2, 1), (0, 1)}
