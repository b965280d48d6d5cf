"""Recorded logs: MCAP files, ROS 1 bags, ROS 2 bags in SQLite. They carry few checksums: what reads is taken."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mutate import mutate_mcap
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore
from target import Target

from salpcc.schemas.errors import LogWarning
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, XYZI, CloudMessage
from salpcc.stages.ingest.sources.bag import Bag, open_log

_ROWS = np.random.default_rng(0).normal(0, 20, (40, 4)).astype("<f4")


def _messages() -> list[tuple[int, bytes]]:
    return [(n, CloudMessage(n, "velodyne", 40, _ROWS.tobytes()).to_cdr()) for n in range(1, 4)]


def _mcaps(folder: Path) -> list[bytes]:
    found = []
    for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
        with open(folder / "whole.mcap", "wb") as stream:
            writer = McapWriter(stream, compression=compression)
            writer.start("ros2", "fuzz")
            channel = writer.register_channel(
                "/points", "cdr", writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
            )
            for time, data in _messages():
                writer.add_message(channel, time, data, time)
            writer.add_attachment(1, 2, "a.txt", "text/plain", b"attached")
            writer.add_metadata("facts", {"a": "b"})
            writer.finish()
        found.append((folder / "whole.mcap").read_bytes())
    (folder / "whole.mcap").unlink()
    return found


def _bags(folder: Path) -> list[bytes]:
    store = get_typestore(Stores.ROS1_NOETIC)
    types, field = store.types, store.types["sensor_msgs/msg/PointField"]
    found = []
    for kind in (Rosbag1Writer.CompressionFormat.LZ4, Rosbag1Writer.CompressionFormat.BZ2, None):
        path = folder / f"{kind}.bag"
        writer = Rosbag1Writer(path)
        if kind is not None:
            writer.set_compression(kind)
        with writer:
            connection = writer.add_connection("/points", PLAIN, typestore=store)
            for time in range(1, 4):
                stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=time)
                cloud = types[PLAIN](
                    header=types["std_msgs/msg/Header"](seq=time, stamp=stamp, frame_id="velodyne"),
                    height=1, width=40, fields=[field(*row) for row in XYZI], is_bigendian=False,
                    point_step=16, row_step=640, data=_ROWS.view(np.uint8).ravel(), is_dense=True,
                )  # fmt: skip
                writer.write(connection, time, bytes(store.serialize_ros1(cloud, PLAIN)))
        found.append(path.read_bytes())
        path.unlink()
    return found


def _sqlite(folder: Path) -> list[bytes]:
    """The file of a bag, its metadata, and the file as rosbag2 compresses it."""
    with Rosbag2Writer(folder / "log", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/points", PLAIN, typestore=get_typestore(Stores.ROS2_HUMBLE))
        for time, data in _messages():
            writer.write(connection, time, data)
    whole = (folder / "log" / "log.db3").read_bytes()
    return [whole, (folder / "log" / "metadata.yaml").read_bytes(), zstandard.compress(whole)]


def _all_scans(root: Path) -> None:
    bag = Bag()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        refs = bag.scans(root, "log")
    for ref in refs:
        scan = bag.read(ref, with_labels=False)
        assert len(scan.points) == len(scan.intensity)


def _read_mcap(_: int, data: bytes, folder: Path) -> None:
    (folder / "log.mcap").write_bytes(data)
    _all_scans(folder)
    for _ in open_log(folder / "log.mcap").enclosed():
        pass


def _read_bag(_: int, data: bytes, folder: Path) -> None:
    (folder / "log.bag").write_bytes(data)
    _all_scans(folder)


def _read_sqlite(which: int, data: bytes, folder: Path) -> None:
    path = folder / "log" / ("log.db3", "metadata.yaml", "log.db3")[which]
    whole = path.read_bytes()
    try:
        path.write_bytes(data)
        _all_scans(folder)
    finally:
        path.write_bytes(whole)


TARGETS = {
    "MCAP log": Target(_mcaps, _read_mcap, 0.06, mutate_mcap),
    "ROS 1 bag": Target(_bags, _read_bag, 0.05),
    "ROS 2 bag": Target(_sqlite, _read_sqlite, 0.05),
}
