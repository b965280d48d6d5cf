"""Side files: the small files that lie with the scans of a sequence, whole, as attachments of its archive."""

from __future__ import annotations

import lzma
import re
from dataclasses import dataclass

from mcap.records import Attachment

from salpcc.stages.residual_code.archive.format import file_name

SIDE = "side:"  # before their names, so that they are none of an archive's own
MOST_BYTES = 1 << 24  # of one file
_MEDIA = "application/x-xz"
_MEMORY = 1 << 27  # bytes that a decoder may take
# Lists of numbers as text hold short matches only: to look for longer ones takes twice as long, and finds none.
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "mf": lzma.MF_BT2, "nice_len": 16, "depth": 4, "pb": 0}]
_LONGEST = 1000  # characters of a name
_SCANS = "velodyne"  # the folder that decoded scans are written to


@dataclass(frozen=True)
class SideFile:
    """A file of a sequence's folder: its path there, with slashes, and its content."""

    name: str
    data: bytes


def side_record(file: SideFile) -> Attachment:
    """Return the attachment of a side file, compressed; inverse of :func:`side_file`."""
    data = lzma.compress(file.data, filters=_FILTERS)
    return Attachment(0, 0, SIDE + file.name, _MEDIA, data)


def side_file(record: Attachment) -> SideFile:
    """Return the side file of an attachment.

    Raises:
        ValueError: it is damaged, too large, or its name leads elsewhere.
    """
    decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
    try:
        data = decoder.decompress(bytes(record.data), MOST_BYTES + 1)
    except lzma.LZMAError as error:
        raise ValueError(f"{record.name} does not decompress ({error})") from error
    if len(data) > MOST_BYTES or not decoder.eof or decoder.unused_data:
        raise ValueError(f"{record.name} is truncated, or of more than {MOST_BYTES} bytes")
    return SideFile(side_name(record.name), data)


def side_name(name: str) -> str:
    """Return the path below the sequence's folder that an attachment's name tells.

    Raises:
        ValueError: it leads out of the folder, or to where scans are.
    """
    path = name.removeprefix(SIDE)
    parts = [file_name(part) for part in path.split("/")]
    odd = len(path) > _LONGEST or any(
        re.search(r"[\x00-\x1f:]", part) or part != part.strip(" ") for part in parts
    )
    if odd or (parts[0] == _SCANS and path.endswith(".bin")):
        raise ValueError(f"{path!r} cannot name a side file")
    return path
