"""The table of loaders has a row for each way to load, and says how often groups were decoded."""

import subprocess
import sys
from pathlib import Path

from salpcc import encode_scans
from salpcc.stages.ingest.sources import SOURCES

SCRIPT = Path(__file__).parents[2] / "scripts" / "loaders.py"


def test_table(toy_root: Path, tmp_path: Path) -> None:
    source = SOURCES["semantickitti"]
    scans = [source.read(ref, True) for ref in source.scans(toy_root, "00")]
    encode_scans(scans, tmp_path / "archives" / "00.mcap", "00", effort="fast", gop=2, labels="given")
    command = [sys.executable, str(SCRIPT), str(tmp_path), str(toy_root)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in printed]
    assert rows[0][0] == "5 scans in 3 groups" and len(rows) == 9
    assert all(float(time) >= 0 for row in rows[2:] for time in row[1:3])
    decoded = {row[0]: row[3] for row in rows[2:]}
    assert decoded["`ScanDataset` in order"] == decoded["`salpcc://` files in order"] == "3"
    assert decoded["`ScanDataset`, `GroupSampler` of 4 groups"] == "3"
