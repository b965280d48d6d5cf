"""One scan of the ``paper`` profile: the streams of its grid, row by row of the table, and all of them back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import GridPrediction, GridSweep
from salpcc.stages.predict.paper.frames import network_weights
from salpcc.stages.residual_code.paper.grid_header import MOTION, GridHeader, content_crc
from salpcc.stages.residual_code.paper.grid_payload import pack, unpack
from salpcc.stages.residual_code.paper.grid_streams import STREAMS, Decoding, Encoding, GridState
from salpcc.stages.residual_code.stream import Payload


def encode_grid(
    sweep: GridSweep, planes: NDArray[np.int32], predicted: GridPrediction, state: GridState
) -> Payload:
    """Encode the next scan of a GOP from its grid sweep, its planes ``(P, 4)`` and its prediction."""
    scan = Encoding(sweep, planes, predicted, state)
    streams = {stream.name: stream.encode(scan) for stream in STREAMS}
    header = GridHeader(
        flags=scan.flags | (MOTION if predicted.motion is not None else 0),
        coder=state.coder,
        n_points=sweep.n_points,
        returns=len(scan.level),
        accuracy=sweep.accuracy,
        content_crc=content_crc(sweep),
        motion=predicted.motion,
        weights=bytes(8) if predicted.motion is None else network_weights(),
    )
    return pack(header, streams)


def decode_grids(payloads: Iterable[bytes]) -> Iterator[GridSweep]:
    """Decode the payloads of one GOP from its first scan on, names and times apart.

    Raises:
        ArchiveError: a payload is damaged, or does not decode to what its checksum says.
    """
    state: GridState | None = None
    for data in payloads:
        header, streams = unpack(data)
        if state is None:
            state = GridState(header.coder)
        if header.coder != state.coder:
            raise ArchiveError(f"payload is of coder {header.coder}, its GOP of {state.coder}")
        yield _decode(header, streams, state)


def _decode(header: GridHeader, streams: dict[str, bytes], state: GridState) -> GridSweep:
    if header.motion is not None and header.weights != network_weights():
        raise ArchiveError(
            f"payload was predicted with the weights {header.weights.hex()}; this version has "
            f"{network_weights().hex()}: decode it with the version that wrote it"
        )
    scan = Decoding(header, state)
    for stream in STREAMS:
        stream.decode(scan, streams[stream.name])
    assert state.elevation is not None
    sweep = GridSweep(
        "", 0, "", header.n_points, header.accuracy, state.elevation, scan.level, scan.intensity, scan.classes
    )
    if content_crc(sweep) != header.content_crc:
        raise ArchiveError("payload decodes to something else than was coded (checksum differs)")
    return sweep
