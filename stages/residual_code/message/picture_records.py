"""A field that looks like a picture: records of kinds BLENDED and LEARNED."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.buffer import ENDLESS, require_sound
from salpcc.stages.entropy.number_forms import (
    BITS,
    DECIMAL,
    SCALES,
    find_scale,
    from_bits,
    from_scale,
    to_scale,
)
from salpcc.stages.residual_code.message.blended_values import MOST, Around, decode_blended, encode_blended
from salpcc.stages.residual_code.message.learned_values import LearnedField, ValueWalk
from salpcc.stages.residual_code.message.points import FIRED, GUIDED, LISTED, OF_ROWS, ROWS, SKY, Points
from salpcc.stages.residual_code.message.records import BLENDED, LEARNED, Integers, Values, unpacked

_BLENDED = struct.Struct("<BBBI")  # what lies around, form, scale, length


def encode_picture(
    values: Values, points: Points, learned: LearnedField | None, to_beat: int, beside: Values | None = None
) -> bytes | None:
    """A field that looks like a picture; None where its values are no whole numbers, or too large, or take more than ``to_beat`` bytes.

    Args:
        beside: of the static layer, where the points are those of the movable one.
    """
    neighbourhoods = [ROWS] * (points.grid is not None) + [FIRED] * points.on_lattice or [LISTED]
    neighbourhoods += [one + GUIDED for one in neighbourhoods]
    if (
        learned is not None and points.grid is not None and values[points.void].any()
    ):  # light is seen without returns, too
        neighbourhoods.append(SKY)
    return _encode_as(neighbourhoods, values, points, learned, beside, to_beat)


def encode_picture_like(
    record: bytes, values: Values, points: Points, learned: LearnedField | None, beside: Values | None = None
) -> bytes | None:
    """The same by the neighbourhood that ``record`` has; None where that cannot be."""
    return _encode_as([_BLENDED.unpack_from(record, 1)[0]], values, points, learned, beside)


def _encode_as(
    neighbourhoods: list[int],
    values: Values,
    points: Points,
    learned: LearnedField | None,
    beside: Values | None,
    to_beat: int = ENDLESS,
) -> bytes | None:
    """The same by the best of these neighbourhoods."""
    if values.dtype.kind != "f":
        form, scale, integers = BITS, 0, values.astype(np.int64)
    else:
        found = find_scale(values)
        if found is None:
            return None
        form, scale, integers = DECIMAL, found, to_scale(values, found)
    if integers.min() <= -MOST or integers.max() >= MOST:
        return None
    kind = BLENDED if learned is None else LEARNED
    best = None
    for what in neighbourhoods:
        around = points.around(what)
        if around is None:
            continue
        whole = _everywhere(what, integers, points, beside, form, scale)
        stream = encode_blended(whole, around, _walk(learned, what, around, points), to_beat)
        if stream is not None and (best is None or len(stream) < len(best[1])):
            best, to_beat = (what, stream), len(stream)
    if best is None:
        return None
    return bytes([kind]) + _BLENDED.pack(best[0], form, scale, len(best[1])) + best[1]


def _everywhere(
    what: int, integers: Integers, points: Points, beside: Values | None, form: int, scale: int
) -> Integers:
    """The integers of all that a walk goes over: of an organised cloud, those of the static layer, too."""
    if what not in OF_ROWS or points.grid is None:
        return integers
    given = None
    if beside is not None and (form == DECIMAL) == (beside.dtype.kind == "f"):
        with np.errstate(invalid="ignore", over="ignore"):
            wide = np.nan_to_num(beside.astype(np.float64)) * SCALES[scale] if form == DECIMAL else beside
            given = np.rint(np.clip(wide, 1 - MOST, MOST - 1)).astype(np.int64)
    return points.grid.spread(integers, given)


def _walk(learned: LearnedField | None, what: int, around: Around, points: Points) -> ValueWalk | None:
    return None if learned is None else learned.walk(what, around, *points.ticks(what), points.passed)


def learned_around(record: bytes) -> int | None:
    """What a record was learned around; None where it was not."""
    return int(_BLENDED.unpack_from(record, 1)[0]) if record[0] == LEARNED else None


def decode_picture(
    data: bytes,
    at: int,
    kind: np.dtype[Any],
    points: Points,
    learned: LearnedField | None = None,
    beside: Values | None = None,
) -> tuple[Values, int]:
    """Inverse of :func:`encode_picture`: the values, and where the record ends; ``at``: behind its kind."""
    (what, form, scale, length), at = unpacked(_BLENDED, data, at)
    around = points.around(what) if what <= (ROWS + GUIDED if learned is None else SKY) else None
    sound = form == (DECIMAL if kind.kind == "f" else BITS) and scale < len(SCALES)
    if around is None or not sound or at + length > len(data):
        raise ArchiveError("payload does not decode")
    walk = _walk(learned, what, around, points)
    given = _everywhere(what, np.zeros(len(points.void), np.int64), points, beside, form, scale)
    integers, sound = decode_blended(around, data[at : at + length], walk, given)
    if what in OF_ROWS and points.grid is not None:
        integers = points.grid.own(integers)
    if learned is not None:
        learned.settle(what)
    require_sound(sound)
    return from_scale(integers, scale, kind) if form == DECIMAL else from_bits(integers, kind), at + length
