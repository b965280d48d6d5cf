"""The records of an archive by their place; every place and length is checked against the file before it is read."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex

from salpcc.schemas.errors import ArchiveError, DamagedError
from salpcc.schemas.files import read_at, why
from salpcc.schemas.mcap_chunks import stream


class RecordFile:
    """A file of MCAP records. It does not stay open, so it can be pickled and forked.

    Attributes:
        path: the file, or its URL.
        size: its bytes.
    """

    def __init__(self, path: Path) -> None:
        """Look at ``path``; raises OSError where it is not there."""
        self.path = path
        self.size = self.path.stat().st_size

    def bytes_at(self, at: int, length: int) -> bytes:
        """Return bytes of the file; raises ArchiveError where they do not lie in it, or it is gone."""
        if at < 0 or length < 0 or at + length > self.size:
            raise DamagedError(
                f"{self.path}: truncated or damaged, wants bytes {at} to {at + length} of {self.size}"
            )
        try:
            return read_at(self.path, at, length)
        except FileNotFoundError as error:
            raise ArchiveError(f"{self.path}: {why(error)}; it was there when it was opened") from error

    def content(self, at: int, opcode: Opcode) -> bytes:
        """Return the content of the record at a byte; raises ArchiveError where it is of another kind."""
        found, length = struct.unpack("<BQ", self.bytes_at(at, 9))
        if found != opcode:
            raise DamagedError(f"{self.path}: byte {at} should start a record {opcode}, holds {found}")
        return self.bytes_at(at + 9, length)

    def record(self, at: int, opcode: Opcode) -> ReadDataStream:
        """Return the content of the record at a byte, to be parsed; raises as :meth:`content`."""
        return stream(self.content(at, opcode))

    def attachment(self, at: AttachmentIndex) -> Attachment:
        """Return an attachment; raises ArchiveError where its CRC does not match."""
        raw = self.content(at.offset, Opcode.ATTACHMENT)
        if zlib.crc32(raw[:-4]) != struct.unpack("<I", raw[-4:])[0]:
            raise DamagedError(f"{self.path}: CRC of {at.name} does not match, the file is damaged")
        return Attachment.read(stream(raw))
