"""The streams of a grid: one row each in the table at the end, its encoder and decoder side by side above it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import COLUMNS, ROWS, GridPrediction, GridSweep
from salpcc.stages.entropy.buffer import as_array, require_sound, run_encoder
from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.ground_fit.grid_planes import PLANE_LIMIT, ground_of, predict_ground
from salpcc.stages.ground_fit.grid_regions import REGIONS
from salpcc.stages.lists.list_values import decode_floats, encode_floats
from salpcc.stages.predict.paper.frames import FramePredictor
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.values import INTENSITY_OF_LEVEL, intensity_levels
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.paper import intensity_coder
from salpcc.stages.residual_code.paper.grid_header import CLASSES, ELEVATION, FLOAT_INTENSITY, GridHeader
from salpcc.stages.residual_code.paper.grid_images import IMAGE_CODERS
from salpcc.stages.residual_code.paper.image_coder import Images
from salpcc.stages.residual_code.stream import Stream

_NOTHING = np.zeros((ROWS, COLUMNS), np.int32)
_CALM = np.zeros((ROWS, COLUMNS), np.uint8)


@dataclass
class GridState:
    """All that goes on through a GOP: adaptive contexts, the elevations, and the prediction network."""

    coder: str
    intensity: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.CONTEXTS))
    by_row: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.LASER_CONTEXTS))
    classes: NDArray[np.uint16] = field(default_factory=lambda: new_bits(class_coder.CONTEXTS))
    elevation: NDArray[np.int16] | None = None
    predictor: FramePredictor | None = None

    def __post_init__(self) -> None:
        self.images = IMAGE_CODERS[self.coder]()


@dataclass
class Encoding:
    """One grid while it is encoded, with its planes ``(P, 4)``; ``flags`` are for its header, the streams set them."""

    sweep: GridSweep
    planes: NDArray[np.int32]
    predicted: GridPrediction
    state: GridState
    flags: int = 0

    def __post_init__(self) -> None:
        rows, columns = np.nonzero(self.sweep.level)
        self.level = self.sweep.level[rows, columns]
        self.starts = ring_starts(rows.astype(np.uint8), ROWS)
        self.tick = columns.astype(np.int32)

    @cached_property
    def coded_images(self) -> tuple[bytes, ...]:
        """Mask, map of the ground, levels."""
        sweep = self.sweep
        images = images_of(self.planes, self.predicted, sweep.elevation, sweep.accuracy)
        return tuple(self.state.images.encode(sweep.level, ground_of(sweep), images))


@dataclass
class Decoding:
    """One grid while it is decoded: what the header tells, and what the streams have told so far."""

    header: GridHeader
    state: GridState
    planes: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 4), np.int32))
    coded_images: list[bytes] = field(default_factory=list)
    level: NDArray[np.int32] = field(default_factory=lambda: _NOTHING)
    intensity: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    classes: NDArray[np.uint8] | None = None

    @cached_property
    def returns(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
        """Starts of the rows, columns and levels of the decoded returns."""
        rows, columns = np.nonzero(self.level)
        return ring_starts(rows.astype(np.uint8), ROWS), columns.astype(np.int32), self.level[rows, columns]


def images_of(
    planes: NDArray[np.int32], predicted: GridPrediction, elevation: NDArray[np.int16], accuracy: float
) -> Images:
    """Return what both sides know of a frame before it, from its planes ``(P, 4)`` and the frames before."""
    ground = predict_ground(planes, elevation, accuracy)
    if predicted.level is None or predicted.spread is None:
        return Images(ground, _NOTHING, _CALM, elevation, accuracy)
    return Images(ground, predicted.level, predicted.spread, elevation, accuracy)


# Elevations of the rows, with the first scan of a group; planes of the ground.


def _encode_side(scan: Encoding) -> bytes:
    """Counts and elevations as one column of integers, planes as four, the region as the gap to the one before."""
    rows_of = []
    if scan.state.elevation is None:
        scan.flags |= ELEVATION
        scan.state.elevation = scan.sweep.elevation
        rows_of = scan.sweep.elevation.tolist()
    heads = np.array([len(scan.planes), *rows_of], np.int64).reshape(-1, 1)
    rows = scan.planes.astype(np.int64)
    rows[:, 0] -= np.arange(len(rows))
    parts = []
    for values in (heads, rows):
        model = integer_model(values.shape[1])
        parts.append(run_encoder(partial(encode_integers, values, model), values.size, model))
    return len(parts[0]).to_bytes(2, "little") + parts[0] + parts[1]


def _decode_side(scan: Decoding, data: bytes) -> None:
    with_elevation = bool(scan.header.flags & ELEVATION)
    cut = 2 + int.from_bytes(data[:2], "little")
    heads, sound = decode_integers(1 + ROWS * with_elevation, 1, integer_model(1), as_array(data[2:cut]))
    count = int(heads[0, 0])
    require_sound(sound and 0 <= count <= REGIONS and not (np.abs(heads[1:]) >> 15).any())
    rows, sound = decode_integers(count, 4, integer_model(4), as_array(data[cut:]))
    rows[:, 0] += np.arange(count)
    regions = rows[:, 0]
    require_sound(sound and not (np.abs(rows[:, 1:]) > PLANE_LIMIT).any())
    require_sound(
        not count or bool(regions[0] >= 0 and regions[-1] < REGIONS and (np.diff(regions) > 0).all())
    )
    if with_elevation:
        scan.state.elevation = heads[1:, 0].astype(np.int16)
        scan.state.predictor = FramePredictor(scan.state.elevation, scan.header.accuracy)
    if scan.state.elevation is None or scan.state.predictor is None:
        raise ArchiveError("payload is not the first of its GOP and has no elevations before it")
    scan.planes = rows.astype(np.int32)


# The three images: a coder takes them together.


def _encode_mask(scan: Encoding) -> bytes:
    return scan.coded_images[0]


def _encode_ground(scan: Encoding) -> bytes:
    return scan.coded_images[1]


def _encode_levels(scan: Encoding) -> bytes:
    return scan.coded_images[2]


def _keep_image(scan: Decoding, stream: bytes) -> None:
    scan.coded_images.append(stream)


def _decode_images(scan: Decoding, stream: bytes) -> None:
    header, state = scan.header, scan.state
    assert state.elevation is not None and state.predictor is not None
    mask, ground = scan.coded_images
    predicted = state.predictor.predict(header.motion)
    images = images_of(scan.planes, predicted, state.elevation, header.accuracy)
    scan.level = state.images.decode(mask, ground, stream, header.returns, images)
    state.predictor.learn(scan.level)


# Intensities: hundredths, or any float.


def _encode_intensity(scan: Encoding) -> bytes:
    floats, state = scan.sweep.intensity, scan.state
    hundredths = intensity_levels(floats)
    if hundredths is None:
        scan.flags |= FLOAT_INTENSITY
        return run_encoder(lambda out: encode_floats(floats, out), len(floats))
    return run_encoder(
        lambda out: intensity_coder.encode_intensity(
            scan.starts, scan.tick, scan.level, hundredths, state.intensity, state.by_row, out
        ),
        len(floats),
        state.intensity,
        state.by_row,
    )


def _decode_intensity(scan: Decoding, stream: bytes) -> None:
    state = scan.state
    if scan.header.flags & FLOAT_INTENSITY:
        scan.intensity, sound = decode_floats(scan.header.returns, as_array(stream))
        require_sound(sound)
        return
    hundredths, sound = intensity_coder.decode_intensity(
        *scan.returns, state.intensity, state.by_row, as_array(stream)
    )
    require_sound(sound)
    scan.intensity = INTENSITY_OF_LEVEL[hundredths]


def _encode_classes(scan: Encoding) -> bytes:
    classes = scan.sweep.classes
    if classes is None:
        return b""
    scan.flags |= CLASSES
    return run_encoder(
        lambda out: class_coder.encode_classes(scan.starts, scan.tick, classes, scan.state.classes, out),
        len(classes),
        scan.state.classes,
    )


def _decode_classes(scan: Decoding, stream: bytes) -> None:
    if scan.header.flags & CLASSES:
        starts, tick, _ = scan.returns
        scan.classes, sound = class_coder.decode_classes(starts, tick, scan.state.classes, as_array(stream))
        require_sound(sound)


STREAMS: tuple[Stream[Encoding, Decoding], ...] = (
    Stream("side", 0, "geometry", _encode_side, _decode_side),
    Stream("mask", 1, "geometry", _encode_mask, _keep_image),
    Stream("ground", 2, "geometry", _encode_ground, _keep_image),
    Stream("levels", 3, "geometry", _encode_levels, _decode_images),
    Stream("intensity", 4, "intensity", _encode_intensity, _decode_intensity),
    Stream("classes", 5, "classes", _encode_classes, _decode_classes),
)
