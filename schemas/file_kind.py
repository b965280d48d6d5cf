"""What a file is by its first bytes, in words for whoever gave it to the wrong command."""

from __future__ import annotations

from pathlib import Path

from salpcc.schemas.files import reading, why

_KINDS = (
    (b"\x89MCAP", "an MCAP file"),
    (b"#ROSBAG V2.0", "a ROS 1 bag"),
    (b"#ROSBAG", "a bag of a ROS before 1.0"),
    (b"SQLite format 3\0", "an SQLite file"),
    (b"ARROW1", "an Arrow file"),
    (b"\x28\xb5\x2f\xfd", "a file compressed by zstd"),
    (b"\x1f\x8b", "a file compressed by gzip"),
    (b"PK\x03\x04", "a zip file"),
    (b"LASF", "a LAS or LAZ file"),
    (b"ply", "a PLY file"),
    (b"# .PCD", "a PCD file"),
)
_HEAD = 512


def kind_of(path: Path) -> str:
    """Say what a file is."""
    if path.is_dir():
        return "a folder"
    try:
        with reading(path) as stream:
            head = stream.read(_HEAD)
    except OSError as error:
        return f"unreadable ({why(error)})"
    for magic, words in _KINDS:
        if head.startswith(magic):
            return words
    if not head:
        return "an empty file"
    text = head.decode("utf-8", "ignore")
    printable = all(sign.isprintable() or sign.isspace() for sign in text)
    return "a text file" if printable and len(text.encode()) > len(head) - 4 else "a binary file"
