"""What the general lossless coders of the paper (Fig. 8) have in common: bytes in, fewer bytes out, and back.

``decode`` is told how many bytes there must be and refuses anything else; it never allocates more than a small
multiple of that, whatever the data say. Settings are those that 7-Zip ZS, whose list of methods the paper's is,
takes by default.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from salpcc.schemas.errors import ArchiveError


@dataclass(frozen=True)
class Lossless:
    """One coder: its title, its settings in words, and its two functions.

    ``decode(data, size)`` raises :class:`ArchiveError` where the data do not decode to ``size`` bytes.
    """

    title: str
    settings: str
    encode: Callable[[bytes], bytes]
    decode: Callable[[bytes, int], bytes]


@contextmanager
def decoding(title: str, *errors: type[Exception]) -> Iterator[None]:
    """Take the ``errors`` of a library for a damaged stream.

    Raises:
        ArchiveError: it is one.
    """
    try:
        yield
    except errors as error:
        raise ArchiveError(f"{title} stream is damaged") from error


def checked(title: str, plain: bytes, size: int, complete: bool = True) -> bytes:
    """Return ``plain`` if it is what was announced.

    Raises:
        ArchiveError: another size, or a stream without its end.
    """
    if len(plain) != size or not complete:
        raise ArchiveError(f"{title} stream does not decode to {size} bytes")
    return plain
