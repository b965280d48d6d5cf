"""What rosbag2 compresses by zstd beside its storage: whole files, and the bytes of messages.

Both are told by the magic number of zstd and not by ``metadata.yaml``, which may be gone or differ: no MCAP, no
SQLite file and no CDR message starts with it.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import zstandard

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import reading, why
from salpcc.schemas.mcap_chunks import MAX_RECORD

COMPRESSED = (".zstd", ".zst")  # ends of file names
_MAGIC = b"\x28\xb5\x2f\xfd"
_PIECE = 1 << 16  # bytes of a file read at once
_FEW = 1 << 8  # of a message: a few bytes may stand for many


def plain_name(name: str) -> str:
    """The name of a file before rosbag2 compressed it."""
    return next((name.removesuffix(end) for end in COMPRESSED if name.endswith(end)), name)


def plain_message(data: bytes, encoding: str) -> bytes:
    """Return the bytes of a message, decompressed where it is a CDR message that rosbag2 compressed.

    Raises:
        ValueError: it ends early, gives more than MAX_RECORD bytes, or something stands behind it.
    """
    if encoding != "cdr" or not data.startswith(_MAGIC):
        return data
    stream = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD).decompressobj()
    plain = bytearray()
    at = 0
    while at < len(data) and not stream.eof and len(plain) <= MAX_RECORD:
        plain += stream.decompress(data[at : at + _FEW])
        at += _FEW
    if not stream.eof or stream.unused_data or at < len(data) or len(plain) > MAX_RECORD:
        raise ValueError(f"a compressed message is not one whole frame of at most {MAX_RECORD} bytes")
    return bytes(plain)


class PlainFiles:
    """Files of a log, those that are compressed unpacked to a temporary folder that goes with this object.

    ``paths`` are where the bytes are.
    """

    def __init__(self, files: list[Path]) -> None:
        """Unpack what has to be.

        Raises:
            SourceError: a file cannot be read, ends early, or there is no room for what is in it.
        """
        self._folder: TemporaryDirectory[str] | None = None
        self.paths = [self._plain(file, f"{number}{file.suffix}") for number, file in enumerate(files)]

    def _plain(self, file: Path, name: str) -> Path:
        try:
            with reading(file) as source:
                if source.read(len(_MAGIC)) != _MAGIC:
                    return file
                source.seek(0)
                self._folder = self._folder or TemporaryDirectory(prefix="salpcc-")
                plain = Path(self._folder.name) / name
                with open(plain, "wb") as out:
                    _unpack(source, out)
                return plain
        except OSError as error:
            raise SourceError(f"{file}: {why(error)}") from error
        except (ValueError, zstandard.ZstdError) as error:
            raise SourceError(f"{file}: {error}") from error


def _unpack(source: BinaryIO, out: BinaryIO) -> None:
    """Decompress frame after frame."""
    stream = None
    piece = source.read(_PIECE)
    while piece:
        stream = stream or zstandard.ZstdDecompressor(max_window_size=MAX_RECORD).decompressobj()
        out.write(stream.decompress(piece))
        piece = stream.unused_data
        if stream.eof:
            stream = None
        piece = piece or source.read(_PIECE)
    if stream is not None:
        raise ValueError("ends early: it is compressed, and its end is missing")
