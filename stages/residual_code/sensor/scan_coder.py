"""One scan of a GOP: its streams, row by row of the table, and all of them back.

The movable layer of a scan is coded like a scan of its own, but for what the static layer tells: where no return can be,
and the motion. Its ranges and intensities are not predicted from the static layer: that was tried, and saved nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.list_coder import are_moved, off_lattice
from salpcc.stages.predict.sweep_walk import supports
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.header import LAYER, MOTION, Header, content_crc
from salpcc.stages.residual_code.sensor.payload import pack, unpack
from salpcc.stages.residual_code.sensor.scan_state import Decoding, Encoding
from salpcc.stages.residual_code.sensor.streams import STREAMS
from salpcc.stages.residual_code.stream import Payload


def encode_scan(
    sweep: Sweep,
    sensor: SensorModel,
    predicted: Prediction,
    state: GopState,
    static: Sweep | None = None,
) -> Payload:
    """Encode the next scan of a GOP from its sweep and the prediction of its levels.

    Args:
        state: of the GOP; the static and the movable layer have their own.
        static: the static layer, where the sweep is the movable one.
    """
    if len(sweep.laser) or (static is not None and static.source is None):
        sweep = replace(sweep, source=None)
    scan = Encoding(sweep, sensor, predicted, state, static)
    streams = {stream.name: stream.encode(scan) for stream in STREAMS}
    motion = sweep.motion if static is None else None
    header = Header(
        flags=scan.flags | (MOTION if motion is not None else 0),
        effort=predicted.effort,
        n_points=sweep.n_points,
        returns=len(sweep.laser),
        strays=len(sweep.stray_index),
        step=sweep.step,
        max_error=sweep.max_error,
        millimetre_reach=scan.reach[0],
        ulp_reach=scan.reach[1],
        content_crc=content_crc(scan.sweep),
        weights=scan.values.weights,
        motion=motion,
    )
    return pack(header, streams)


def decode_scan(data: bytes, sensor: SensorModel, state: GopState, static: Sweep | None = None) -> Sweep:
    """Decode the next scan of a GOP; inverse of :func:`encode_scan`, name and time apart.

    Args:
        static: the decoded static layer, where the payload is of the movable one.

    Raises:
        ArchiveError: the payload is damaged, or does not decode to what its checksum says.
    """
    header, streams = unpack(data)
    if bool(header.flags & LAYER) != (static is not None):
        raise ArchiveError("payload is of another layer of the scan")
    if header.returns > sensor.n_lasers * sensor.ticks_per_turn:
        raise ArchiveError("payload has more returns than the sensor has firings")
    if header.effort != "fast" and not supports(sensor):
        raise ArchiveError(f"payload of effort {header.effort} is of a sensor that the networks do not know")
    motion = header.motion if static is None else static.motion
    scan = Decoding(header, sensor, state, static, _nothing_yet(header, motion), streams)
    for stream in STREAMS:
        stream.decode(scan, streams[stream.name])
    if content_crc(scan.sweep) != header.content_crc:
        raise ArchiveError("payload decodes to something else than was coded (checksum differs)")
    state.before = scan.sweep
    return scan.sweep


class OnLattice(NamedTuple):
    """What a payload says of its points and the lattice of its sensor.

    Attributes:
        off: points on no lattice: strays, but for those that the sensor's model explains.
        unmoved: whether all points are strays that lie where the sensor saw them, as no motion is told.
    """

    off: int
    unmoved: bool


def on_lattice(data: bytes) -> OnLattice:
    """Look at a payload of profile ``sensor``.

    Raises:
        ArchiveError: it is none.
    """
    header, streams = unpack(data)
    strays = streams["stray_points"]
    unmoved = header.returns == 0 and header.motion is None and not are_moved(strays)
    return OnLattice(off_lattice(header.strays, strays), unmoved)


def _nothing_yet(header: Header, motion: np.ndarray | None) -> Sweep:
    """The sweep of a header before any stream is decoded."""
    return Sweep(
        name="",
        time=0,
        frame_id="",
        n_points=header.n_points,
        motion=motion,
        step=header.step,
        max_error=header.max_error,
        laser=np.zeros(0, np.uint8),
        tick=np.zeros(0, np.int32),
        count=np.zeros(0, np.int32),
        intensity=np.zeros(0, np.float32),
        millimetre=np.zeros(0, np.uint8),
        ulp=np.zeros(0, np.uint8),
        classes=None,
        stray_index=np.zeros(0, np.int64),
        stray_points=np.zeros((0, 4), np.float32),
        stray_classes=None,
    )
