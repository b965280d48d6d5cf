"""The golden archive of a log: it gives the same messages for ever, and is written to the same payload bytes.

If a test here fails, the format changed: bump the codec version (schemas/ARCHIVE.md, section 8) and run
``python tests/golden/make_golden_log.py``.
"""

import json
from hashlib import sha256
from pathlib import Path

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.log import messages
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.gop import decode_gop, encode_gop

LOG = Path(__file__).parents[2] / "golden" / "log"


def test_gives_the_same_messages() -> None:
    archive = Archive.open(LOG / "log.mcap")
    told = [
        [channel.topic, m.log_time, m.publish_time, m.sequence, sha256(m.data).hexdigest()]
        for channel, m in messages(archive, iter(archive))
    ]
    assert told == json.loads((LOG / "messages.json").read_text())


def test_encodes_to_the_same_payloads() -> None:
    reader = ArchiveReader(LOG / "log.mcap")
    for gop in range(len(reader.gops)):
        payloads = [payload.data for payload in reader.payloads(gop)]
        again = encode_gop(decode_gop(payloads, reader.facts.sensor), reader.facts.sensor, "fast")
        assert [payload.data for payload in again] == payloads
