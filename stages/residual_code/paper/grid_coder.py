"""One scan of the ``paper`` profile: every stream of its grid sweep, and all of them back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import COLUMNS, ROWS, GridPrediction, GridSweep
from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.ground_fit.grid_planes import PLANE_LIMIT, ground_of, predict_ground
from salpcc.stages.ground_fit.grid_regions import REGIONS
from salpcc.stages.predict.paper.frames import FramePredictor, network_weights
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.values import INTENSITY_OF_LEVEL, intensity_levels
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.paper import intensity_coder
from salpcc.stages.residual_code.paper.grid_images import IMAGE_CODERS
from salpcc.stages.residual_code.paper.grid_payload import (
    CLASSES,
    ELEVATION,
    FLOAT_INTENSITY,
    MOTION,
    GridHeader,
    content_crc,
    pack,
    unpack,
)
from salpcc.stages.residual_code.paper.image_coder import Images
from salpcc.stages.residual_code.sensor.payload import Payload
from salpcc.stages.strays.stray_coder import decode_floats, encode_floats

_NOTHING = np.zeros((ROWS, COLUMNS), np.int32)
_CALM = np.zeros((ROWS, COLUMNS), np.uint8)


@dataclass
class GridModels:
    """All that goes on through a GOP: adaptive contexts, the elevations, and the prediction network."""

    coder: str
    intensity: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.CONTEXTS))
    by_row: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.LASER_CONTEXTS))
    classes: NDArray[np.uint16] = field(default_factory=lambda: new_bits(class_coder.CONTEXTS))
    elevation: NDArray[np.int16] | None = None
    predictor: FramePredictor | None = None

    def __post_init__(self) -> None:
        self.images = IMAGE_CODERS[self.coder]()


def encode_grid(
    sweep: GridSweep, planes: NDArray[np.int32], predicted: GridPrediction, models: GridModels
) -> Payload:
    """Encode the next scan of a GOP from its grid sweep, its planes ``(P, 4)`` and its prediction."""
    flags = 0
    if models.elevation is None:
        flags |= ELEVATION
        models.elevation = sweep.elevation
    rows, columns = np.nonzero(sweep.level)
    level = sweep.level[rows, columns]
    starts = ring_starts(rows.astype(np.uint8), ROWS)
    tick = columns.astype(np.int32)
    images = images_of(planes, predicted, sweep.elevation, sweep.accuracy)
    streams = [
        _encode_side(sweep.elevation if flags & ELEVATION else None, planes),
        *models.images.encode(sweep.level, ground_of(sweep), images),
    ]
    hundredths = intensity_levels(sweep.intensity)
    if hundredths is None:
        flags |= FLOAT_INTENSITY
        streams.append(run_encoder(lambda out: encode_floats(sweep.intensity, out), len(level)))
    else:
        streams.append(
            run_encoder(
                lambda out: intensity_coder.encode_intensity(
                    starts, tick, level, hundredths, models.intensity, models.by_row, out
                ),
                len(level),
            )
        )
    if sweep.classes is not None:
        flags |= CLASSES
        streams.append(
            run_encoder(
                lambda out: class_coder.encode_classes(starts, tick, sweep.classes, models.classes, out),
                len(level),
            )
        )
    else:
        streams.append(b"")
    flags |= MOTION if predicted.motion is not None else 0
    header = GridHeader(
        flags, models.coder, sweep.n_points, len(level), sweep.accuracy, content_crc(sweep),
        predicted.motion, bytes(8) if predicted.motion is None else network_weights(),
    )  # fmt: skip
    return pack(header, streams)


def decode_grids(payloads: Iterable[bytes]) -> Iterator[GridSweep]:
    """Decode the payloads of one GOP from its first scan on, names and times apart.

    Raises:
        ArchiveError: a payload is damaged, or does not decode to what its checksum says.
    """
    models: GridModels | None = None
    for data in payloads:
        header, streams = unpack(data)
        if models is None:
            models = GridModels(header.coder)
        if header.coder != models.coder:
            raise ArchiveError(f"payload is of coder {header.coder}, its GOP of {models.coder}")
        yield _decode(header, streams, models)


def _decode(header: GridHeader, streams: list[bytes], models: GridModels) -> GridSweep:
    side, mask, ground_map, levels, intensity, classes = streams
    elevation, planes = _decode_side(bool(header.flags & ELEVATION), side)
    if elevation is not None:
        models.elevation = elevation
        models.predictor = FramePredictor(elevation, header.accuracy)
    if models.elevation is None or models.predictor is None:
        raise ArchiveError("payload is not the first of its GOP and has no elevations before it")
    if header.motion is not None and header.weights != network_weights():
        raise ArchiveError(
            f"payload was predicted with the weights {header.weights.hex()}; this version has "
            f"{network_weights().hex()}: decode it with the version that wrote it"
        )
    predicted = models.predictor.predict(header.motion)
    images = images_of(planes, predicted, models.elevation, header.accuracy)
    level = models.images.decode(mask, ground_map, levels, header.returns, images)
    models.predictor.learn(level)
    rows, columns = np.nonzero(level)
    tick, values = columns.astype(np.int32), level[rows, columns]
    starts = ring_starts(rows.astype(np.uint8), ROWS)
    data = np.frombuffer(bytearray(intensity), np.uint8)
    if header.flags & FLOAT_INTENSITY:
        floats, sound = decode_floats(header.returns, data)
    else:
        hundredths, sound = intensity_coder.decode_intensity(
            starts, tick, values, models.intensity, models.by_row, data
        )
        floats = INTENSITY_OF_LEVEL[hundredths] if sound else INTENSITY_OF_LEVEL[:0]
    labels = None
    if header.flags & CLASSES and sound:
        labels, sound = class_coder.decode_classes(
            starts, tick, models.classes, np.frombuffer(bytearray(classes), np.uint8)
        )
    if not sound:
        raise ArchiveError("payload does not decode")
    sweep = GridSweep(
        "", 0, "", header.n_points, header.accuracy, models.elevation, level, floats, labels
    )  # fmt: skip
    if content_crc(sweep) != header.content_crc:
        raise ArchiveError("payload decodes to something else than was coded (checksum differs)")
    return sweep


def images_of(
    planes: NDArray[np.int32], predicted: GridPrediction, elevation: NDArray[np.int16], accuracy: float
) -> Images:
    """Return what both sides know of a frame before it, from its planes ``(P, 4)`` and the frames before."""
    ground = predict_ground(planes, elevation, accuracy)
    if predicted.level is None or predicted.spread is None:
        return Images(ground, _NOTHING, _CALM, elevation, accuracy)
    return Images(ground, predicted.level, predicted.spread, elevation, accuracy)


def _encode_side(elevation: NDArray[np.int16] | None, planes: NDArray[np.int32]) -> bytes:
    """Counts and elevations as one column of integers, planes as four, the region as the gap to the one before."""
    rows_of = [] if elevation is None else elevation.tolist()
    heads = np.array([len(planes), *rows_of], np.int64).reshape(-1, 1)
    rows = planes.astype(np.int64)
    rows[:, 0] -= np.arange(len(rows))
    parts = []
    for values in (heads, rows):
        model = integer_model(values.shape[1])
        parts.append(run_encoder(partial(encode_integers, values, model), values.size))
    return len(parts[0]).to_bytes(2, "little") + parts[0] + parts[1]


def _decode_side(with_elevation: bool, data: bytes) -> tuple[NDArray[np.int16] | None, NDArray[np.int32]]:
    """Inverse of :func:`_encode_side`."""
    cut = 2 + int.from_bytes(data[:2], "little")
    head = np.frombuffer(bytearray(data[2:cut]), np.uint8)
    heads, sound = decode_integers(1 + ROWS * with_elevation, 1, integer_model(1), head)
    count = int(heads[0, 0])
    possible = 0 <= count <= REGIONS and not (np.abs(heads[1:]) >> 15).any()
    if not sound or not possible:
        raise ArchiveError("payload does not decode")
    body = np.frombuffer(bytearray(data[cut:]), np.uint8)
    rows, sound = decode_integers(count, 4, integer_model(4), body)
    rows[:, 0] += np.arange(count)
    regions = rows[:, 0]
    if (
        not sound
        or (np.abs(rows[:, 1:]) > PLANE_LIMIT).any()
        or (count and (regions[0] < 0 or regions[-1] >= REGIONS or (np.diff(regions) <= 0).any()))
    ):
        raise ArchiveError("payload does not decode")
    return heads[1:, 0].astype(np.int16) if with_elevation else None, rows.astype(np.int32)
