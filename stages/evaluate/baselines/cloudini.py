"""Cloudini, where its ``cloudini_rosbag_converter`` is on the PATH: ROS messages in MCAP files, in and out.

What counts is the compressed message, framing and field list included, not the file around it. The resolution
is twice the asked error; the program applies it to every float field, so only geometry goes in. The time is
the program's own CPU time, files included.
"""

from __future__ import annotations

import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from salpcc.schemas.messages import COMPRESSED, PLAIN, SCHEMA_TEXT, XYZI, CloudMessage
from salpcc.stages.evaluate.baselines.contract import Baseline, NotPossible, Points, Promise, step_of

PROGRAM = "cloudini_rosbag_converter"
_LIMIT_S = 60
_HEAD = struct.Struct("<d")  # step; the program wants none to decode, but a bound needs it


def encode(points: Points, max_error: float) -> bytes:
    """Encode by way of a file with one PointCloud2 message."""
    step = step_of(max_error)
    places = np.ascontiguousarray(points[:, :3])
    if not np.isfinite(places).all():
        raise NotPossible("points that are not finite cannot be quantised")
    message = CloudMessage(
        stamp=0,
        frame_id="",
        width=len(places),
        data=places.tobytes(),
        point_step=12,
        fields=XYZI[:3],
    )
    return _HEAD.pack(step) + _convert(message.to_cdr(), PLAIN, ["--compress", "--resolution", f"{step:.9g}"])


def decode(data: bytes) -> Points:
    """Decode by way of a file with one CompressedPointCloud2 message."""
    plain = _convert(data[_HEAD.size :], COMPRESSED, ["--decode"])
    message = CloudMessage.from_cdr(plain, compressed=False)
    columns = message.point_step // 4
    return np.frombuffer(message.data, np.float32).reshape(-1, columns)[:, :3].copy()


def _convert(message: bytes, kind: str, options: list[str]) -> bytes:
    """Send one message through the program.

    Raises:
        NotPossible: the program fails or takes more than a minute; its last line says why.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, result = Path(folder) / "in.mcap", Path(folder) / "out.mcap"
        _write(source, message, kind)
        command = [PROGRAM, "--yes", "--filename", str(source), "--output", str(result), *options]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise NotPossible(f"{PROGRAM} took more than {_LIMIT_S} s") from error
        if done.returncode or not result.exists():
            lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
            raise NotPossible(f"{PROGRAM} failed: {lines[-1]}")
        return _read(result)


def _write(path: Path, message: bytes, kind: str) -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", SCHEMA_TEXT[kind].encode())
        channel = writer.register_channel("/points", "cdr", schema)
        writer.add_message(channel, 0, message, 0)
        writer.finish()


def _read(path: Path) -> bytes:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages():
            return bytes(message.data)
    raise NotPossible(f"{PROGRAM} wrote a file without messages")


CLOUDINI = Baseline(
    title="Cloudini",
    packages=(),
    promise=Promise(bound="axis", order=True, count=True, intensity=False),
    encode=encode,
    decode=decode,
    program=PROGRAM,
)
