"""Side files of a damaged archive: the attachments whose CRC holds, found by the beginning of their name."""

from __future__ import annotations

import mmap
import re
import struct
import zlib

from mcap.records import Attachment

from salpcc.schemas.mcap_chunks import PARSE_ERRORS, stream
from salpcc.stages.residual_code.archive.side_files import SideFile, side_file

# An attachment: length below 2^40, times 0, length of the name, the prefix of side files.
_SIDE = re.compile(rb"\x09(?=.{5}\0\0\0\0{16}.{3}\0side:)", re.DOTALL)
_HEAD = 9


def side_files(data: mmap.mmap) -> tuple[list[SideFile], int]:
    """Return the side files that are whole, and how many are not."""
    found: dict[str, SideFile] = {}
    broken = 0
    for match in _SIDE.finditer(data):
        at = match.start() + _HEAD
        (length,) = struct.unpack("<Q", data[at - 8 : at])
        content = data[at : at + length]
        try:
            if zlib.crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
                raise ValueError("CRC differs")
            file = side_file(Attachment.read(stream(content)))
            found.setdefault(file.name, file)
        except PARSE_ERRORS:
            broken += 1
    return list(found.values()), broken
