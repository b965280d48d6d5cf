"""Golden archives: what a release wrote, every later one reads to the same bits and writes to the same bytes.

If a test here fails, the format changed: bump the codec version (schemas/ARCHIVE.md, section 8) and run
``python tests/golden/make_golden.py``.
"""

import json
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from salpcc.pipeline.archive import Archive
from salpcc.stages.residual_code.archive.format import ScanPayload
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.sensor.header import CODEC_VERSION

GOLDEN = Path(__file__).parents[2] / "golden"
EXPECTED = json.loads((GOLDEN / "expected.json").read_text())
ARCHIVES = sorted(EXPECTED["archives"])
CODED_AGAIN = GOLDEN / "coded_again.py"


def test_all_archives_are_there() -> None:
    assert EXPECTED["codec_version"] == CODEC_VERSION
    assert sorted(path.name for path in GOLDEN.glob("*.mcap")) == ARCHIVES
    assert sum(path.stat().st_size for path in GOLDEN.iterdir() if path.is_file()) < 400_000


@pytest.mark.parametrize("name", ARCHIVES)
def test_decodes_to_the_same_bits(name: str) -> None:
    expected = EXPECTED["archives"][name]
    with Archive.open(GOLDEN / name) as archive:
        scans = list(archive)
    assert [scan.name for scan in scans] == list(expected)
    for scan in scans:
        digests = {
            "points": sha256(scan.points.astype("<f4").tobytes()).hexdigest(),
            "intensity": sha256(scan.intensity.astype("<f4").tobytes()).hexdigest(),
            "classes": "" if scan.classes is None else sha256(scan.classes.tobytes()).hexdigest(),
            "n": len(scan),
        }
        assert digests == expected[scan.name]


@pytest.mark.parametrize("name", ARCHIVES)
def test_is_what_went_in(name: str) -> None:
    with np.load(GOLDEN / "input.npz") as stored, Archive.open(GOLDEN / name) as archive:
        for scan in archive:
            points = stored[f"points_{scan.name}"]
            assert scan.intensity.tobytes() == stored[f"intensity_{scan.name}"].tobytes()
            if name.endswith("_exact.mcap"):
                assert scan.points.tobytes() == points.tobytes()
                continue
            finite = np.isfinite(points).all(axis=1)
            assert scan.points[~finite].tobytes() == points[~finite].tobytes()
            off = np.linalg.norm(scan.points[finite].astype(np.float64) - points[finite], axis=1)
            assert 0.0 < off.max() <= 0.01


@pytest.mark.parametrize("name", ARCHIVES)
def test_encodes_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    reader = ArchiveReader(GOLDEN / name)
    facts = reader.facts
    again = []
    for gop in range(len(reader.gops)):
        payloads = reader.payloads(gop)
        sweeps = decode_gop((payload.data for payload in payloads), facts.sensor)
        coded = encode_gop(sweeps, facts.sensor, facts.config["effort"])
        for payload, new in zip(payloads, coded, strict=True):
            assert new.data == payload.data, f"the payload of scan {payload.entry.name} has changed"
        again.append(
            [
                ScanPayload(old.entry, old.time, old.frame_id, new.data)
                for old, new in zip(payloads, coded, strict=True)
            ]
        )
    write_archive(tmp_path / name, facts, again)
    assert (tmp_path / name).read_bytes() == (GOLDEN / name).read_bytes(), "the container has changed"


@pytest.mark.parametrize(
    ("processor", "names"), [("generic", ARCHIVES), ("x86-64-v3", ["default_exact.mcap"])]
)
def test_other_processors_give_the_same(processor: str, names: list[str]) -> None:
    """Kernels compiled for no particular processor (no AVX, no FMA), and for AVX2, against the golden bytes.

    The tests above compile them for this machine: AVX-512, where it has that.
    """
    features = llvm.get_host_cpu_features()
    if processor != "generic" and not (features.get("avx2") and features.get("fma")):
        pytest.skip(f"this machine cannot run code for {processor}")
    environment = os.environ | {
        "NUMBA_CPU_NAME": processor,
        "NUMBA_CPU_FEATURES": "",
    }  # numba keeps kernels by these
    command = [sys.executable, str(CODED_AGAIN), *(str(GOLDEN / name) for name in names)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    expected = [
        f"{name} {scan} {facts['points']} same"
        for name in names
        for scan, facts in EXPECTED["archives"][name].items()
    ]
    assert done.stdout.splitlines() == expected
