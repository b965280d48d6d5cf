"""PC-HEVC of the paper (Fig. 6): 8-bit HEVC pictures of the range images, then the residual exactly.

The 16-bit range images of PC-PNG are scaled to 8 bits and coded as pictures: each alone (Intra), or each
predicted from the one before (Inter). What the decoded pictures leave is coded losslessly, so the range levels
come back exactly and the accuracy is met in one pass. Not stated in the paper and chosen here: empty cells are
filled from their left before a picture is coded, one grey scale for all pictures of a group, QP 22, preset
medium, no B pictures, groups of eight scans, and xz for the residual and the mask of filled cells.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import (
    Baseline,
    Group,
    NotPossible,
    Points,
    Promise,
    step_of,
)
from salpcc.stages.evaluate.baselines.packing import pack, unpack
from salpcc.stages.evaluate.baselines.tile_image import COLUMNS, ROWS, project, to_levels, unproject

_QP = 22
_GROUP = 8
_HEAD = struct.Struct("<dHII")  # step, levels per grey value, bytes of the picture, of the mask


def encode_group(scans: Sequence[Points], max_error: float, inter: bool) -> list[bytes]:
    """Encode range images of consecutive scans; see the contract."""
    step = step_of(max_error)
    images = [to_levels(project(points), step).astype(np.int32) for points in scans]
    scale = max(1, -(-max(int(levels.max()) for levels in images) // 255))
    grey = [np.rint(_fill(levels) / scale).astype(np.uint8) for levels in images]
    pictures = _encode_pictures(grey, inter)
    parts = []
    for levels, picture, seen in zip(images, pictures, _decode_pictures(pictures), strict=True):
        filled = levels > 0
        residual = (levels - seen.astype(np.int32) * scale)[filled]
        mask = pack(np.packbits(filled).tobytes())
        head = _HEAD.pack(step, scale, len(picture), len(mask))
        parts.append(head + picture + mask + pack(_to_planes(residual)))
    return parts


def decode_group(parts: Sequence[bytes]) -> list[Points]:
    """Decode what :func:`encode_group` gave, Intra or Inter: the pictures say which."""
    heads = [_HEAD.unpack_from(part) for part in parts]
    pictures = [part[_HEAD.size : _HEAD.size + head[2]] for part, head in zip(parts, heads, strict=True)]
    clouds = []
    for part, (step, scale, *sizes), grey in zip(parts, heads, _decode_pictures(pictures), strict=True):
        ends = np.cumsum([_HEAD.size, *sizes, len(part)]).tolist()
        _, mask, rest = (part[start:end] for start, end in pairwise(ends))
        filled = np.unpackbits(np.frombuffer(unpack(mask), np.uint8)).reshape(ROWS, COLUMNS).astype(bool)
        levels = np.zeros((ROWS, COLUMNS), np.int32)
        levels[filled] = grey[filled].astype(np.int32) * scale + _from_planes(unpack(rest))
        clouds.append(unproject(levels * float(step)))
    return clouds


def _fill(levels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give empty cells the level of the nearest filled cell on their left, so that the picture is smooth."""
    column = np.where(levels > 0, np.arange(levels.shape[1]), 0)
    return np.take_along_axis(levels, np.maximum.accumulate(column, axis=1), axis=1)


def _encode_pictures(grey: Sequence[NDArray[np.uint8]], inter: bool) -> list[bytes]:
    """Encode 8-bit pictures with x265, one packet each."""
    import av

    codec: Any = av.CodecContext.create("libx265", "w")
    codec.height, codec.width = grey[0].shape
    codec.pix_fmt, codec.time_base = "gray", Fraction(1, 10)
    parameters = f"qp={_QP}:keyint={len(grey) if inter else 1}:min-keyint=1:bframes=0:scenecut=0"
    codec.options = {
        "preset": "medium",
        "x265-params": f"{parameters}:log-level=none:pools=none:frame-threads=1",
    }
    packets = []
    for number, picture in enumerate(grey):
        frame = av.VideoFrame.from_ndarray(picture, format="gray")
        frame.pts = number
        packets += codec.encode(frame)
    packets += codec.encode(None)
    if len(packets) != len(grey):
        raise NotPossible(f"x265 made {len(packets)} packets of {len(grey)} pictures")
    return [bytes(packet) for packet in packets]


def _decode_pictures(pictures: Sequence[bytes]) -> list[NDArray[np.uint8]]:
    import av

    codec: Any = av.CodecContext.create("hevc", "r")
    codec.thread_count = 1
    frames = [frame for picture in pictures for frame in codec.decode(av.Packet(picture))]
    frames += codec.decode(None)
    if len(frames) != len(pictures):
        raise NotPossible(f"{len(pictures)} HEVC pictures decode to {len(frames)} frames")
    return [np.asarray(frame.to_ndarray(format="gray")) for frame in frames]


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


def _baseline(title: str, inter: bool) -> Baseline:
    def encode(scans: Sequence[Points], max_error: float) -> list[bytes]:
        return encode_group(scans, max_error, inter)

    return Baseline(
        title=title,
        packages=("av",),
        promise=Promise(bound="none", order=False, count=False, intensity=False),
        encode=lambda points, max_error: encode([points], max_error)[0],
        decode=lambda data: decode_group([data])[0],
        group=Group(_GROUP, encode, decode_group) if inter else None,
    )


HEVC_INTRA = _baseline("PC-HEVC-Intra", inter=False)
HEVC_INTER = _baseline("PC-HEVC-Inter", inter=True)
