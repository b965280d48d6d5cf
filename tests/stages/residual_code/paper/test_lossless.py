"""The nine lossless coders: one contract, and damage never does more than to be refused."""

import zlib
from contextlib import suppress

import numpy as np
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.paper.lossless import CODERS

_RNG = np.random.default_rng(3)
PLAIN = {
    "empty": b"",
    "one": b"x",
    "short": b"abcabcabcabcabcabcabcab",
    "zeros": bytes(5000),
    "noise": _RNG.bytes(3000),
    "residuals": np.abs(_RNG.normal(0, 9, 40_000)).astype(np.uint8).tobytes(),
    "runs": np.repeat(
        _RNG.integers(0, 9, 30_000, dtype=np.uint8), 6
    ).tobytes(),  # more than a block of Lizard
    "far": (_RNG.bytes(70_000) * 3)[:200_000],  # matches beyond 16-bit offsets
}


@pytest.mark.parametrize("name", CODERS)
@pytest.mark.parametrize("kind", PLAIN)
def test_round_trip(name: str, kind: str) -> None:
    coder, plain = CODERS[name], PLAIN[kind]
    data = coder.encode(plain)
    assert coder.decode(data, len(plain)) == plain
    for wrong in {len(plain) + 1, max(len(plain) - 1, 0)} - {len(plain)}:
        with pytest.raises(ArchiveError):
            coder.decode(data, wrong)


@pytest.mark.parametrize("name", CODERS)
def test_redundancy_is_removed(name: str) -> None:
    assert len(CODERS[name].encode(PLAIN["zeros"])) < 200
    assert len(CODERS[name].encode(PLAIN["runs"])) < len(PLAIN["runs"]) / 2


@pytest.mark.parametrize("name", CODERS)
def test_damage_is_refused_or_decodes_to_the_announced_size(name: str) -> None:
    rng = np.random.default_rng(4)
    coder = CODERS[name]
    for plain in (PLAIN["short"], PLAIN["residuals"][:3000], PLAIN["runs"][:9000]):
        data = coder.encode(plain)
        for _ in range(60):
            broken = bytearray(data)
            for _ in range(int(rng.integers(1, 4))):
                broken[int(rng.integers(len(broken)))] = int(rng.integers(256))
            end = int(rng.integers(len(broken) + 1)) if rng.random() < 0.3 else len(broken)
            size = len(plain) if rng.random() < 0.7 else int(rng.integers(20_000))
            with suppress(ArchiveError):
                assert len(coder.decode(bytes(broken[:end]), size)) == size


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("lz5", b"\x80\x01"),  # a match before anything is written
        ("lz5", b"\x08a\x61"),  # the last offset before there is one, then no end
        ("lz5", b"\x38\xff\xff"),  # a length that never ends
        ("lizard", b"\x14\x01" + bytes(15)),  # a Huff0 stream
        ("lizard", b"\x14\x80\xff\xff\xff"),  # more plain bytes than there are
        (
            "lizard",
            b"\x14\x00" + b"\x00\x00\x00" * 3 + b"\x01\x00\x00\x20" + b"\x00\x00\x00",
        ),  # no offset left
    ],
)
def test_streams_that_lie_are_refused(name: str, data: bytes) -> None:
    with pytest.raises(ArchiveError):
        CODERS[name].decode(data, 100)


def test_a_wrong_stream_of_the_deflate64_library_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong:
        def deflate(self, plain: bytes) -> bytes:
            return zlib.compress(plain[:-1], wbits=-15)

        def flush(self) -> bytes:
            return b""

    coder, plain = CODERS["deflate64"], PLAIN["short"]
    monkeypatch.setattr("inflate64.Deflater", Wrong)
    assert coder.decode(coder.encode(plain), len(plain)) == plain


def test_lz5_token_layout() -> None:
    """Bytes written by hand from the published block format."""
    coder = CODERS["lz5"]
    # 00_011_010 and offset 3: three literals, then 5 bytes from 3 back; 00_010_000: two literals at the end.
    assert coder.decode(bytes([0b00011010]) + b"abc" + bytes([3, 0, 0b00010000]) + b"yz", 10) == b"abcabcabyz"
    # 1_00_11_000 with a length byte of 1: four literals, 10-bit offset 1; 011_00_001: the last offset again, 4 bytes.
    assert (
        coder.decode(bytes([0b10011000, 1]) + b"pqrs" + bytes([1, 0b01100001, 0]), 11) == b"pqrs" + b"s" * 7
    )
    # 010_01_000: one literal, 24-bit offset 1, 3 bytes.
    assert coder.decode(bytes([0b01001000]) + b"k" + bytes([1, 0, 0, 0]), 4) == b"kkkk"


def test_lizard_token_layout() -> None:
    """Bytes written by hand from the published block format."""
    streams = [b"\x01", b"\x03\x00", b"", bytes([0b0_0101_011, 0b1_0000_111]), b"abc" + b"12345678" + b"rest"]
    block = b"".join(len(s).to_bytes(3, "little") + s for s in streams)
    assert CODERS["lizard"].decode(b"\x14\x00" + block, 20) == b"abcabcab12345678rest"
