"""Write the golden archive of a log: ``log/log.mcap``, and the messages that it must give back, ``log/messages.json``.

Run it by hand, and only when the codec version changes (schemas/ARCHIVE.md, section 8)::

    python tests/golden/make_golden_log.py

Two topics: an organised cloud with NaN, a ring, times, garbage as padding; big-endian float64 points. One text passes through.
"""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.log import messages
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.ingest.point_cloud import message_to_scan
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import encode_gop

FOLDER = Path(__file__).parent / "log"
POINTS = SCHEMA_TEXT[PLAIN].encode()
CHANNELS = (
    LogChannel(1, "/organised", "cdr", PLAIN, "ros2msg", POINTS, (("offered_qos_profiles", ""),)),
    LogChannel(2, "/wide", "cdr", PLAIN, "ros2msg", POINTS, (("offered_qos_profiles", ""),)),
    LogChannel(3, "/texts", "json", "", "", b""),
)


def organised(number: int) -> bytes:
    rng = np.random.default_rng(number)
    fields = (
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("intensity", 16, 7, 1),
        ("ring", 20, 4, 1),
        ("t", 24, 6, 1),
    )
    kind = np.dtype({"names": [f[0] for f in fields], "formats": ["<f4"] * 4 + ["<u2", "<u4"],
                     "offsets": [f[1] for f in fields], "itemsize": 29})  # fmt: skip
    # A view: a copy of such rows would leave out what stands between the fields.
    rows = rng.integers(0, 256, (8, 60 * 29), dtype=np.uint8).view(kind)
    for axis in "xyz":
        rows[axis] = np.where(rng.random((8, 60)) < 0.2, np.nan, rng.normal(0, 20, (8, 60)))
    rows["intensity"] = rng.integers(0, 40, (8, 60)).cumsum(axis=1) % 256
    rows["ring"] = np.arange(8)[:, None]
    rows["t"] = np.arange(60) * 97_650 + rng.integers(0, 9, 60)
    return CloudMessage(number, "lidar", 60, rows.tobytes(), None, False, 8, 29, fields).to_cdr()


def wide(number: int) -> bytes:
    rng = np.random.default_rng(number)
    fields = (
        ("x", 0, 8, 1),
        ("y", 8, 8, 1),
        ("z", 16, 8, 1),
        ("intensity", 24, 2, 1),
        ("stamp", 25, 8, 1),
        ("normal", 33, 7, 3),
    )
    kind = np.dtype({"names": [f[0] for f in fields], "formats": [*["<f8"] * 3, "u1", "<f8", ("<f4", 3)],
                     "offsets": [f[1] for f in fields], "itemsize": 45})  # fmt: skip
    rows = np.zeros(100, kind)
    for axis in "xyz":
        rows[axis] = 5e5 + rng.normal(0, 30, 100)
    rows["intensity"], rows["stamp"] = rng.integers(0, 256, 100), 1.6e9 + 1e-5 * np.arange(100)
    rows["normal"] = rng.normal(0, 1, (100, 3))
    return CloudMessage(number, "map", 100, rows.tobytes(), None, True, 1, 45, fields).to_cdr()


def told(archive: Archive) -> list[list[str | int]]:
    """The messages of a log: topic, times, number, SHA-256 of the bytes."""
    return [
        [c.topic, m.log_time, m.publish_time, m.sequence, sha256(m.data).hexdigest()]
        for c, m in messages(archive, iter(archive))
    ]


def main() -> None:
    sensor = load_sensor("hdl64e")
    gops = []
    for channel, make in ((CHANNELS[0], organised), (CHANNELS[1], wide)):
        scans = []
        for n in range(2):
            message = LogMessage(channel.id, 1000 + 100 * n, 1010 + 100 * n, n, make(n))
            scans.append(message_to_scan(message, "cdr", channel.topic, f"{channel.topic[1:]}-{n:06d}"))
        classes = [np.arange(len(scan)) // 7 % 20 for scan in scans]
        scans = [replace(scan, classes=c.astype(np.uint8)) for scan, c in zip(scans, classes, strict=True)]
        sweeps = [scan_to_sweep(scan, sensor) for scan in scans]
        gops.append(
            [
                ScanPayload(
                    ScanEntry(s.name, s.n_points, len(s), 0, len(s.stray_index), **payload.sizes),
                    s.time, s.frame_id, payload.data,
                )
                for s, payload in zip(sweeps, encode_gop(sweeps, sensor, "fast"), strict=True)
            ]
        )  # fmt: skip
    FOLDER.mkdir(exist_ok=True)
    facts = ArchiveFacts("log", "bag", "", {"effort": "fast"}, sensor)
    log = PassingLog(CHANNELS, iter([LogMessage(3, 1050, 1050, 7, b'{"text": "hello"}')]))
    write_archive(FOLDER / "log.mcap", facts, gops, log)
    expected = told(Archive.open(FOLDER / "log.mcap"))
    (FOLDER / "messages.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
