"""Records of MCAP files that nobody vouches for: no length is believed before it is checked."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata

from salpcc.schemas.log import Enclosed, LogAttachment, LogMetadata

MAX_RECORD = 1 << 28  # bytes of a record, of a chunk compressed or not: two point clouds of the largest kind
_PIECE = 1 << 20
HEAD = struct.Struct("<BQ")
# What a damaged record makes of itself when it is parsed.
PARSE_ERRORS = (
    EndOfFile, struct.error, ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError,
    RuntimeError, zstandard.ZstdError,
)  # fmt: skip


def stream(content: bytes) -> ReadDataStream:
    """Give bytes to the readers of :mod:`mcap.records`."""
    return ReadDataStream(BytesIO(content))


def top_records(file: BinaryIO, size: int, start: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start of the content and length of each record of a file from ``start`` on.

    Raises:
        ValueError: a record ends outside the file.
    """
    at = start
    while at + HEAD.size <= size:
        file.seek(at)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        at += HEAD.size
        if at + length > size:
            raise ValueError(f"ends early: the record at byte {at - HEAD.size} is cut off")
        yield opcode, at, length
        at += length


def records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield opcode, place and content of the records of a chunk.

    Raises:
        ValueError: a record ends outside.
    """
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        start = at + HEAD.size
        if start + length > len(data):
            raise ValueError("a record of a chunk ends outside it")
        yield opcode, at, data[start : start + length]
        at = start + length


def read_chunk(file: BinaryIO, at: int, length: int) -> bytes:
    """Read the records of the chunk whose content is at ``at``, decompressed and checked by its CRC.

    Raises:
        ValueError: it is larger than MAX_RECORD, damaged, or compressed in an unknown way.
    """
    if length > MAX_RECORD:
        raise ValueError(f"the chunk at byte {at} has {length} bytes, more than {MAX_RECORD} are not read")
    file.seek(at)
    return open_chunk(file.read(length), at)


def open_chunk(content: bytes, at: int) -> bytes:
    """Decompress and check the records of a chunk that is in hand; see :func:`read_chunk`."""
    chunk = Chunk.read(stream(content))
    data = decompress(chunk.compression, bytes(chunk.data), chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError(f"the chunk at byte {at} is damaged (CRC differs)")
    return data


def read_enclosed(opcode: int, content: bytes) -> Enclosed:
    """Read an Attachment or Metadata record.

    Raises:
        ValueError: it is damaged.
    """
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(stream(content))
        return LogMetadata(metadata.name, tuple(metadata.metadata.items()))
    (crc,) = struct.unpack("<I", content[-4:])
    if crc and zlib.crc32(content[:-4]) != crc:
        raise ValueError("an attachment is damaged (CRC differs)")
    found = Attachment.read(stream(content))
    return LogAttachment(found.log_time, found.create_time, found.name, found.media_type, bytes(found.data))


def enclosed_record(found: Enclosed) -> Attachment | Metadata:
    """Return the record of what a log encloses; inverse of :func:`read_enclosed`."""
    if isinstance(found, LogMetadata):
        return Metadata(found.name, dict(found.facts))
    return Attachment(found.create_time, found.log_time, found.name, found.media_type, found.data)


def decompress(compression: str, data: bytes, size: int) -> bytes:
    """Decompress to ``size`` bytes and never more; inverse of :func:`compress` among others.

    Raises:
        ValueError: it gives other than ``size`` bytes, or ``size`` is more than MAX_RECORD.
    """
    if size > MAX_RECORD:
        raise ValueError(f"a chunk claims {size} bytes, more than {MAX_RECORD} are not read")
    if compression == "zstd":
        reader = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD).stream_reader(data)
        plain = _gather(reader.read, size)
    elif compression == "lz4":
        frame = lz4.frame.LZ4FrameDecompressor()
        given = iter([data])
        plain = _gather(lambda most: b"" if frame.eof else frame.decompress(next(given, b""), most), size)
    elif compression == "":
        plain = data
    else:
        raise ValueError(f"compression {compression} is not known")
    if len(plain) != size:
        raise ValueError(f"a chunk gives other than its {size} bytes")
    return plain


def _gather(read: Callable[[int], bytes], size: int) -> bytes:
    """Read piece by piece up to one byte more than ``size``: what is claimed is not allocated before it comes."""
    plain = bytearray()
    while len(plain) <= size:
        piece = read(min(size + 1 - len(plain), _PIECE))
        if not piece:
            break
        plain += piece
    return bytes(plain)


def compress(data: bytes) -> bytes:
    """Compress by zstd."""
    return zstandard.ZstdCompressor(level=3, write_checksum=False).compress(data)
