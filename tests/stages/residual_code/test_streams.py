"""The table of streams: a toy row is coded, counted, framed and decoded like those that are there."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.sensor import payload, scan_coder
from salpcc.stages.residual_code.sensor.scan_state import Decoding, Encoding
from salpcc.stages.residual_code.sensor.streams import STREAMS
from salpcc.stages.residual_code.stream import Stream


def _encode_number(scan: Encoding) -> bytes:
    return len(scan.sweep).to_bytes(4, "little")


def _decode_number(scan: Decoding, stream: bytes) -> None:
    require_sound(stream == len(scan.sweep).to_bytes(4, "little"))


def test_a_toy_stream(
    make_scan: Callable[..., Scan], sensor: SensorModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = scan_to_sweep(make_scan(0, stride=16), sensor)
    (plain,) = encode_gop([sweep], sensor, "fast")
    table = (*STREAMS, Stream("number", len(STREAMS), "side", _encode_number, _decode_number))
    monkeypatch.setattr(scan_coder, "STREAMS", table)
    monkeypatch.setattr(payload, "STREAMS", table)
    (coded,) = encode_gop([sweep], sensor, "fast")
    assert sum(coded.sizes.values()) == len(coded.data) == len(plain.data) + 8  # four bytes, and their length
    assert coded.sizes["side"] == plain.sizes["side"] + 4
    (back,) = decode_gop([coded.data], sensor)
    assert len(back) == len(sweep)
    header, streams = payload.unpack(coded.data)
    wrong = payload.pack(header, streams | {"number": bytes(4)})
    with pytest.raises(ArchiveError, match="does not decode"):
        list(decode_gop([wrong.data], sensor))


def test_every_row_has_its_own_name_and_place() -> None:
    assert sorted(row.place for row in STREAMS) == list(range(len(STREAMS)))
    assert len({row.name for row in STREAMS}) == len(STREAMS)
