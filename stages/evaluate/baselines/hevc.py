"""PC-HEVC-Intra of the paper (Fig. 6): an 8-bit HEVC picture of the range image, then the residual exactly.

The 16-bit range image of PC-PNG is scaled to 8 bits and coded as one intra picture; what the decoded picture
leaves is coded losslessly, so the range levels come back exactly and the accuracy is met in one pass. Not
stated in the paper and chosen here: empty cells are filled from their left before the picture is coded, QP 22,
preset medium, and xz for the residual and the mask of filled cells.
"""

from __future__ import annotations

import lzma
import struct
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.contract import Baseline, NotPossible, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.range_image import project, to_levels, unproject

_QP = 22
_HEAD = struct.Struct("<dHHII")  # step, levels per grey value, rows, bytes of the picture, of the mask
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]


def encode(points: Points, max_error: float) -> bytes:
    """Encode the range image; see the contract."""
    step = step_of(max_error)
    levels = to_levels(project(points), step).astype(np.int32)
    filled = levels > 0
    scale = max(1, -(-int(levels.max()) // 255))
    grey = np.rint(_fill(levels) / scale).astype(np.uint8)
    picture = _encode_picture(grey)
    residual = (levels - _decode_picture(picture).astype(np.int32) * scale)[filled]
    mask = _pack(np.packbits(filled).tobytes())
    rest = _pack(_to_planes(residual))
    return _HEAD.pack(step, scale, levels.shape[0], len(picture), len(mask)) + picture + mask + rest


def decode(data: bytes) -> Points:
    """Decode the range image to points."""
    step, scale, rows, picture_size, mask_size = _HEAD.unpack_from(data)
    start = _HEAD.size + picture_size
    grey = _decode_picture(data[_HEAD.size : start]).astype(np.int32)
    bits = np.unpackbits(np.frombuffer(_unpack(data[start : start + mask_size]), np.uint8))
    filled = bits[: grey.size].reshape(rows, -1).astype(bool)
    levels = np.zeros(grey.shape, np.int32)
    levels[filled] = grey[filled] * scale + _from_planes(_unpack(data[start + mask_size :]))
    return unproject(levels * float(step))


def _fill(levels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give empty cells the level of the nearest filled cell on their left, so that the picture is smooth."""
    column = np.where(levels > 0, np.arange(levels.shape[1]), 0)
    return np.take_along_axis(levels, np.maximum.accumulate(column, axis=1), axis=1)


def _encode_picture(grey: NDArray[np.uint8]) -> bytes:
    import av

    codec: Any = av.CodecContext.create("libx265", "w")
    codec.height, codec.width = grey.shape
    codec.pix_fmt, codec.time_base = "gray", Fraction(1, 10)
    parameters = f"qp={_QP}:keyint=1:log-level=none:pools=none:frame-threads=1"
    codec.options = {"preset": "medium", "x265-params": parameters}
    frame = av.VideoFrame.from_ndarray(grey, format="gray")
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])


def _decode_picture(data: bytes) -> NDArray[np.uint8]:
    import av

    codec: Any = av.CodecContext.create("hevc", "r")
    codec.thread_count = 1
    frames = [*codec.decode(av.Packet(data)), *codec.decode(None)]
    if len(frames) != 1:
        raise NotPossible(f"the HEVC picture decodes to {len(frames)} frames")
    return np.asarray(frames[0].to_ndarray(format="gray"))


def _to_planes(residual: NDArray[np.int32]) -> bytes:
    """Low bytes of the zigzag-folded residual, then the high bytes: the latter are nearly all 0."""
    folded = ((residual << 1) ^ (residual >> 31)).astype(np.uint32)
    return (folded & 0xFF).astype(np.uint8).tobytes() + (folded >> 8).astype("<u2").tobytes()


def _from_planes(data: bytes) -> NDArray[np.int32]:
    """Inverse of :func:`_to_planes`."""
    count = len(data) // 3
    low, high = np.frombuffer(data[:count], np.uint8), np.frombuffer(data[count:], "<u2")
    folded = (high.astype(np.int32) << 8) | low
    return (folded >> 1) ^ -(folded & 1)


def _pack(data: bytes) -> bytes:
    return lzma.compress(data, lzma.FORMAT_RAW, filters=_FILTERS)


def _unpack(data: bytes) -> bytes:
    return lzma.decompress(data, lzma.FORMAT_RAW, filters=_FILTERS)


HEVC_INTRA = Baseline(
    title="PC-HEVC-Intra",
    packages=("av",),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
