"""What payloads of both profiles are made of: a row of a table of streams codes one part of a scan, and brings it back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

Encoding = TypeVar("Encoding")  # a scan while it is encoded
Decoding = TypeVar("Decoding")  # a scan while it is decoded

GROUPS = ("geometry", "intensity", "classes", "side")


class Stream(NamedTuple, Generic[Encoding, Decoding]):
    """One stream of a payload.

    Args:
        place: in the payload.
        group: of GROUPS, whose bytes the report counts it to.
        encode: returns the bytes of the stream.
        decode: takes them, and what the rows before it found.
        flag: of the header where the stream is there only with it; it then has a length of its own.
    """

    name: str
    place: int
    group: str
    encode: Callable[[Encoding], bytes]
    decode: Callable[[Decoding, bytes], None]
    flag: int = 0


@dataclass(frozen=True)
class Payload:
    """Bytes of one scan and how many of them each group of streams took; the groups add up to all."""

    data: bytes
    sizes: dict[str, int]
