"""Decode archives, encode them again, and print what came out of each scan: ``python tests/golden/coded_again.py FILE...``.

``make test`` runs it before the tests, which leaves the codec's kernels compiled, and the tests run it for other processors.
"""

from __future__ import annotations

import sys
from hashlib import sha256
from pathlib import Path

from salpcc.stages.lattice.sweep import sweep_to_scan
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.gop import decode_gop, encode_gop

for path in sys.argv[1:]:
    reader = ArchiveReader(path)
    for gop in range(len(reader.gops)):
        payloads = reader.payloads(gop)
        sweeps = list(decode_gop((payload.data for payload in payloads), reader.facts.sensor))
        again = encode_gop(sweeps, reader.facts.sensor, reader.facts.config["effort"])
        for payload, sweep, coded in zip(payloads, sweeps, again, strict=True):
            points = sweep_to_scan(sweep, reader.facts.sensor).points
            same = "same" if coded.data == payload.data else "other"
            print(Path(path).name, payload.entry.name, sha256(points.tobytes()).hexdigest(), same)
