"""Damage to bytes, and checksums mended afterwards, so that damage gets past them."""

from __future__ import annotations

import struct
import zlib

import numpy as np

# Numbers that lengths and counts are least prepared for.
_ODD = [
    0,
    1,
    -1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    1 << 40,
    (1 << 63) - 1,
    1 << 62,
]
_TOKENS = [
    b"\0",
    b"[" * 2000,
    b"{" * 50,
    b"../../x",
    b"1e999",
    b"NaN",
    b"-1",
    b"\xff\xfe",
    b"9" * 400,
    b"&a *a",
    b'""',
]


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One of: flipped bits, random bytes, a cut, an insertion, an odd number, a swap, a doubled part, a token."""
    body = bytearray(data or b"\0")
    at = int(rng.integers(0, len(body)))
    kind = int(rng.integers(0, 9))
    if kind == 0:
        for bit in rng.integers(0, 8 * len(body), rng.integers(1, 9)):
            body[bit // 8] ^= 1 << (bit % 8)
    elif kind == 1:
        body[at : at + 16] = rng.bytes(len(body[at : at + 16]))
    elif kind == 2:
        body = body[:at]
    elif kind == 3:
        body[at:at] = rng.bytes(int(rng.integers(1, 40)))
    elif kind == 4:
        width = int(rng.choice([2, 4, 8]))
        number = int(_ODD[rng.integers(0, len(_ODD))]) % (1 << 8 * width)
        body[at : at + width] = number.to_bytes(width, "little")
    elif kind == 5:
        other = int(rng.integers(0, len(body)))
        body[at : at + 8], body[other : other + 8] = body[other : other + 8], body[at : at + 8]
    elif kind == 6:
        body[at:at] = body[at : at + int(rng.integers(1, 2000))]
    elif kind == 7:
        body[at : at + 4] = _TOKENS[rng.integers(0, len(_TOKENS))]
    else:
        head = int(rng.integers(0, min(100, len(body))))
        body[head] = int(rng.integers(0, 256))
    return bytes(body)


def mutate_payload(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a payload; half of the time its checksum is mended, so that the kernels see it."""
    body = mutate(data[:-4], rng)
    return body + (zlib.crc32(body).to_bytes(4, "little") if rng.random() < 0.5 else data[-4:])


def mutate_mcap(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage an MCAP file; half of the time inside one record, all checksums and lengths mended after."""
    if rng.random() < 0.5:
        return mutate(data, rng)
    records = records_of(data)
    # Small records decide more than large ones, so each is hit as often.
    hit = int(rng.integers(0, len(records)))
    records[hit] = records[hit][0], mutate(records[hit][1], rng)
    return sealed(data, records)


def records_of(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and content of the records of a whole MCAP file."""
    records, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        records.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return records


def sealed(data: bytes, records: list[tuple[int, bytes]]) -> bytes:
    """Make a file of records, between the magics of ``data``, and put all checksums right."""
    out, summary = bytearray(data[:8]), 0
    for opcode, content in records:
        if opcode == 0x09 and len(content) > 4:  # attachment
            content = content[:-4] + zlib.crc32(content[:-4]).to_bytes(4, "little")
        if opcode == 0x06 and len(content) > 40 and content[28:32] == bytes(4):  # chunk, not compressed
            content = content[:24] + zlib.crc32(content[40:]).to_bytes(4, "little") + content[28:]
        if opcode == 0x0F:  # data end
            content = zlib.crc32(out).to_bytes(4, "little")
            summary = len(out) + 13
        if opcode == 0x02 and len(content) >= 20:  # footer
            head = struct.pack("<BQQ", opcode, 20, summary) + content[8:16]
            content = head[9:] + zlib.crc32(head, zlib.crc32(out[summary:])).to_bytes(4, "little")
        out += struct.pack("<BQ", opcode, len(content)) + content
    return bytes(out + data[-8:])
