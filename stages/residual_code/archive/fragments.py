"""Find the records of a damaged archive by their shape, without its index and without trusting a length.

What is given back carries a CRC that holds, except the messages of a broken chunk: those are for the
caller to check (:mod:`~salpcc.stages.residual_code.archive.salvage`).
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Message

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.messages import CloudMessage
from salpcc.stages.residual_code.archive.documents import MARK, unpack_document
from salpcc.stages.residual_code.archive.format import GOP_HEAD, GOP_OPCODE

BROKEN = (
    ArchiveError, EndOfFile, struct.error, ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError,
)  # fmt: skip
RECORD_HEAD = 9  # opcode, length
_CHUNK_HEAD = RECORD_HEAD + 40  # times, size, CRC, no compression, length of the records
# A length below 2^40, times, size and CRC, an empty name of a compression, a length below 2^40.
_CHUNK = re.compile(rb"\x06(?=.{5}\0\0\0.{28}\0\0\0\0.{5}\0\0\0)", re.DOTALL)


@dataclass(frozen=True)
class Place:
    """A chunk, or what is left of it.

    Attributes:
        start: its first byte.
        end: one past its last message.
        messages: where the content of each message starts and ends.
        whole: whether the CRC of the chunk holds, or the file ends within it.
    """

    start: int
    end: int
    messages: tuple[tuple[int, int], ...]
    whole: bool


def attachments(data: mmap.mmap, name: str) -> Iterator[Any]:
    """Yield the content of the attachments of that name that hold a document and whose CRC holds."""
    # Log and create time are 0 in an archive, the media type is empty.
    mark = bytes(16) + struct.pack("<I", len(name)) + name.encode() + bytes(4)
    at = data.find(mark)
    while at >= 0:
        try:
            body = at + len(mark) + 8
            (length,) = struct.unpack_from("<Q", data, body - 8)
            (crc,) = struct.unpack_from("<I", data, body + length)
            if zlib.crc32(data[at : body + length]) == crc:
                yield unpack_document(data[body : body + length])
        except BROKEN:
            pass
        at = data.find(mark, at + 1)


def gop_records(data: mmap.mmap) -> Iterator[tuple[int, int, Any]]:
    """Yield start, end and content of the records before chunks whose CRC holds."""
    at = data.find(MARK)
    while at >= 0:
        start = at - GOP_HEAD.size
        try:
            opcode, length, crc = GOP_HEAD.unpack(data[max(start, 0) : at])
            end = start + RECORD_HEAD + length
            if opcode == GOP_OPCODE and end <= len(data) and zlib.crc32(data[at:end]) == crc:
                yield start, end, unpack_document(data[at:end])
        except BROKEN:
            pass
        at = data.find(MARK, at + 1)


def chunks(data: mmap.mmap, likely: Iterable[int]) -> Iterator[Place]:
    """Yield chunks in the order of the file; ``likely`` are places where one should start, come what may."""
    wanted, at = sorted(likely, reverse=True), 0
    while True:
        match = _CHUNK.search(data, at)
        found = [
            start for start in (match and match.start(), wanted[-1] if wanted else None) if start is not None
        ]
        if not found:
            return
        start = min(found)
        while wanted and wanted[-1] <= start:
            wanted.pop()
        place = _place(data, start)
        if place.messages:
            yield place
        at = max(start + 1, place.end)
        while wanted and wanted[-1] < at:
            wanted.pop()


def _place(data: mmap.mmap, start: int) -> Place:
    messages = []
    at = start + _CHUNK_HEAD
    while at + RECORD_HEAD <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode != Opcode.MESSAGE or at + RECORD_HEAD + length > len(data):
            break
        messages.append((at + RECORD_HEAD, at + RECORD_HEAD + length))
        at += RECORD_HEAD + length
    return Place(start, at, tuple(messages), bool(messages) and _whole(data, start, at))


def _whole(data: mmap.mmap, start: int, end: int) -> bool:
    first = start + _CHUNK_HEAD
    opcode, content, _, _, size, crc, compression, length = struct.unpack("<BQQQQIIQ", data[start:first])
    if opcode != Opcode.CHUNK or compression or not content - 40 == size == length:
        return False
    return first + length > len(data) or (first + length == end and zlib.crc32(data[first:end]) == crc)


def clouds(data: mmap.mmap, place: Place) -> Iterator[tuple[Message, CloudMessage]]:
    """Yield the messages of a chunk, up to the first that cannot be parsed."""
    try:
        for start, end in place.messages:
            message = Message.read(ReadDataStream(BytesIO(data[start:end])), end - start)
            yield message, CloudMessage.from_cdr(message.data, compressed=True)
    except BROKEN:
        return
