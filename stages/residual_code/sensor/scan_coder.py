"""One scan of a GOP: every stream of its sweep, and all of them back.

The movable layer of a scan is coded like a scan of its own, but for what the static layer tells: where no return can be,
and the motion. Its ranges and intensities are not predicted from the static layer: that was tried, and saved nothing.
"""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.lattice.lattice import NO_CORRECTION, unproject
from salpcc.stages.lattice.layers import alone, movable_mask
from salpcc.stages.lattice.publish import (
    compensated_points,
    float32_boundary,
    millimetre_boundary,
)
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.hundredths import INTENSITY_OF_LEVEL, intensity_levels
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.sweep_walk import supports
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.message.logged_scan import (
    decode_logged,
    decode_stray_classes,
    encode_intensity,
    encode_logged,
    encode_stray_classes,
    intensity_is_field,
    told_times,
)
from salpcc.stages.residual_code.sensor import correction_coder, layer_mask_coder, mask_coder
from salpcc.stages.residual_code.sensor.gop_models import GopModels
from salpcc.stages.residual_code.sensor.payload import (
    CLASSES,
    CLOUD,
    FLOAT_INTENSITY,
    LAYER,
    MOTION,
    Header,
    Payload,
    content_crc,
    pack,
    unpack,
)
from salpcc.stages.strays.ray_coder import Layout
from salpcc.stages.strays.stray_coder import (
    decode_strays,
    encode_strays,
    plan,
)
from salpcc.stages.strays.stray_values import decode_values, encode_values

Array = NDArray[np.uint8]
_LENGTH = struct.Struct("<I")


def encode_scan(
    sweep: Sweep,
    sensor: SensorModel,
    predicted: Prediction,
    models: GopModels,
    static: Sweep | None = None,
) -> Payload:
    """Encode the next scan of a GOP from its sweep and the prediction of its levels.

    Args:
        models: of the GOP; the static and the movable layer have their own.
        static: the static layer, where the sweep is the movable one.
    """
    values = models.values(predicted.effort)
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    tick, level = sweep.tick, sweep.count
    n, s = len(level), len(sweep.stray_index)
    flags = 0
    reach = [-1.0, -1.0]
    streams = [
        run_encoder(lambda out: _encode_mask(starts, tick, sensor, models, static, out), n),
        values.encode_levels(sweep, predicted),
    ]
    if sweep.max_error == 0:
        model = unproject(sensor, sweep.laser, tick, level)
        points = compensated_points(model, sweep.millimetre, sweep.motion)
        roundings = (
            (sweep.millimetre, millimetre_boundary(model), models.millimetre),
            (sweep.ulp, float32_boundary(points), models.ulp),
        )
        for which, (codes, (distance, step), bits) in enumerate(roundings):
            reach[which] = correction_coder.correction_reach(distance, codes)
            streams.append(_corrections(distance, step, reach[which], codes, bits))
    else:
        streams += [b"", b""]
    # What lies in file order, the layer has in the order of its own points.
    listed = sweep
    if static is not None and sweep.cloud is not None:
        listed = alone(sweep, movable_mask(static, sweep, sensor))
    # Of points without a lattice, by their place in the list, which a movable layer's have not.
    moved = sweep.motion if n == 0 and static is None else None
    lanes, times = _lanes(listed), None if n else told_times(listed)
    strays = plan(sweep.stray_points[:, :3], sweep.max_error, sensor, moved, lanes=lanes, times=times)
    layout = strays.layout
    streams.append(encode_strays(sweep.stray_index, strays))
    levels = intensity_levels(sweep.intensity)
    if intensity_is_field(sweep, levels):
        flags |= FLOAT_INTENSITY
        streams.append(encode_intensity(listed, sensor, strays.told))
    elif levels is None:
        flags |= FLOAT_INTENSITY
        streams.append(run_encoder(lambda out: encode_values(sweep.intensity, (1, 0), out), n))
    else:
        streams.append(values.encode_intensity(levels, predicted))
    if intensity_is_field(sweep, levels):
        streams.append(b"")
    else:
        streams.append(run_encoder(lambda out: encode_values(sweep.stray_points[:, 3], layout, out), s))
    if sweep.classes is not None and sweep.stray_classes is not None:
        flags |= CLASSES
        returned = run_encoder(
            lambda out: class_coder.encode_classes(starts, tick, sweep.classes, models.classes, out), n
        )
        of_strays = (
            encode_stray_classes(sweep) if sweep.cloud else _plain_classes(sweep.stray_classes, layout)
        )
        streams.append(of_strays + returned)
    else:
        streams.append(b"")
    if sweep.cloud is not None:
        flags |= CLOUD
        stream, listed = encode_logged(listed, sensor, models.envelope, strays.told)
        sweep = replace(sweep, cloud=listed.cloud)
        streams.append(stream)
    else:
        streams.append(b"")
    if static is not None:
        flags |= LAYER
    streams.append(b"" if sweep.lead is None else _encode_lead(sweep.lead))
    motion = sweep.motion if static is None else None
    header = Header(
        flags | (MOTION if motion is not None else 0), predicted.effort, sweep.n_points, n, s, sweep.step,
        sweep.max_error, reach[0], reach[1], content_crc(sweep), values.weights, motion,
    )  # fmt: skip
    return pack(header, streams)


def _lanes(sweep: Sweep) -> Array | None:
    """The lasers of the strays ``(S,)`` as their message tells them, if it does."""
    rings = None if sweep.cloud is None else sweep.cloud.rings()
    return None if rings is None or rings.max(initial=0) > 255 else rings[sweep.stray_index].astype(np.uint8)


def _encode_mask(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    sensor: SensorModel,
    models: GopModels,
    static: Sweep | None,
    out: Array,
) -> int:
    if static is None:
        return int(
            mask_coder.encode_mask(
                starts, tick, sensor.shift, sensor.ticks_per_turn, models.firing, models.mask, out
            )
        )
    return int(
        layer_mask_coder.encode_layer_mask(
            ring_starts(static.laser, sensor.n_lasers), static.tick, starts, tick, sensor.shift,
            sensor.ticks_per_turn, models.layer_firing, models.layer_mask, out,
        )
    )  # fmt: skip


def _encode_lead(lead: NDArray[np.int64]) -> bytes:
    """Encode how many returns of the movable layer stand before each stray of the static one; nothing for zeros."""
    if not lead.any():
        return b""
    return run_encoder(lambda out: int(encode_integers(lead[:, None], integer_model(1), out)), len(lead))


def _decode_lead(n: int, data: Array) -> tuple[NDArray[np.int64], bool]:
    """Inverse of :func:`_encode_lead`; ``n`` strays, and whether the data made sense."""
    if len(data) == 0:
        return np.zeros(n, np.int64), True
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return rows[:, 0].copy(), bool(sound)


def _corrections(
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
    reach: float,
    codes: Array,
    bits: NDArray[np.uint16],
) -> bytes:
    if reach < 0:
        return b""
    return run_encoder(
        lambda out: correction_coder.encode_corrections(distance, step, reach, codes, bits, out), len(codes)
    )


def _plain_classes(classes: Array, layout: Layout) -> bytes:
    """Classes of strays: length, values. Nothing without strays."""
    if not len(classes):
        return b""
    stream = run_encoder(lambda out: encode_values(classes.astype(np.float32), layout, out), len(classes))
    return _LENGTH.pack(len(stream)) + stream


def _read_plain_classes(n: int, data: Array) -> tuple[Array, int]:
    """Inverse of :func:`_plain_classes`: the classes, none where the data do not hold them, and the bytes that they took."""
    if n == 0 or len(data) < _LENGTH.size:
        return np.zeros(0, np.uint8), 0
    end = _LENGTH.size + _LENGTH.unpack(data[: _LENGTH.size].tobytes())[0]
    values, sound = decode_values(n, data[_LENGTH.size : end].copy())
    whole = sound and end <= len(data) and bool((values >= 0).all() and (values <= 255).all())
    return values.astype(np.uint8) if whole else np.zeros(0, np.uint8), end


def decode_scan(data: bytes, sensor: SensorModel, models: GopModels, static: Sweep | None = None) -> Sweep:
    """Decode the next scan of a GOP; inverse of :func:`encode_scan`, name and time apart.

    Args:
        static: the decoded static layer, where the payload is of the movable one.

    Raises:
        ArchiveError: the payload is damaged, or does not decode to what its checksum says.
    """
    header, streams = unpack(data)
    if bool(header.flags & LAYER) != (static is not None):
        raise ArchiveError("payload is of another layer of the scan")
    motion = header.motion if static is None else static.motion
    values = models.known(header.effort, header.weights)
    if header.returns > sensor.n_lasers * sensor.ticks_per_turn:
        raise ArchiveError("payload has more returns than the sensor has firings")
    if header.effort != "fast" and not supports(sensor):
        raise ArchiveError(f"payload of effort {header.effort} is of a sensor that the networks do not know")
    sound = True

    def checked(result):  # type: ignore[no-untyped-def]
        nonlocal sound
        sound = sound and bool(result[-1])
        if not sound:
            raise ArchiveError("payload does not decode")
        return result[0] if len(result) == 2 else result[:-1]

    mask, levels, millimetre, ulp, stray, intensity, stray_intensity, classes = (
        np.frombuffer(bytearray(stream), np.uint8) for stream in streams[:8]
    )
    as_field = bool(header.flags & CLOUD and header.flags & FLOAT_INTENSITY)
    n, s = header.returns, header.strays
    laser, tick = checked(
        mask_coder.decode_mask(sensor.shift, sensor.ticks_per_turn, n, models.firing, models.mask, mask)
        if static is None
        else layer_mask_coder.decode_layer_mask(
            ring_starts(static.laser, sensor.n_lasers), static.tick, sensor.shift, sensor.ticks_per_turn, n,
            models.layer_firing, models.layer_mask, mask,
        )
    )  # fmt: skip
    starts = ring_starts(laser, sensor.n_lasers)
    before = models.warped(header.effort, motion)
    count = checked(values.decode_levels(starts, tick, header.step, before, levels))
    mm_codes = np.full(n, NO_CORRECTION, np.uint8)
    ulp_codes = np.full(n, NO_CORRECTION, np.uint8)
    if header.max_error == 0:
        model = unproject(sensor, laser, tick, count)
        if header.millimetre_reach >= 0:
            mm_codes = checked(
                correction_coder.decode_corrections(
                    *millimetre_boundary(model), header.millimetre_reach, models.millimetre, millimetre
                )
            )
        if header.ulp_reach >= 0:
            points = compensated_points(model, mm_codes, motion)
            ulp_codes = checked(
                correction_coder.decode_corrections(
                    *float32_boundary(points), header.ulp_reach, models.ulp, ulp
                )
            )
    moved = header.motion if n == 0 else None
    places, points, told = checked(decode_strays(s, header.max_error, stray, sensor, moved))
    if told is not None and (n or not header.flags & CLOUD):
        raise ArchiveError("payload does not decode")
    if as_field:
        intensities = np.zeros(n, np.float32)
    elif header.flags & FLOAT_INTENSITY:
        intensities = checked(decode_values(n, intensity))
    else:
        intensities = INTENSITY_OF_LEVEL[
            checked(values.decode_intensity(starts, tick, count, header.step, before, intensity))
        ]
    fourth = np.zeros(s, np.float32) if as_field else checked(decode_values(s, stray_intensity))
    of_all = n + s + (0 if static is None else len(static))
    if s and (places[0] < 0 or places[-1] >= of_all or (np.diff(places) <= 0).any()):
        raise ArchiveError("payload does not decode")
    lead = None
    if static is not None:
        lead = checked(_decode_lead(len(static.stray_index), np.frombuffer(bytearray(streams[9]), np.uint8)))
    sweep = Sweep(
        "", 0, "", header.n_points, motion, header.step, header.max_error,
        laser, tick, count, intensities, mm_codes, ulp_codes, None,
        places, np.column_stack([points, fourth]), None, lead=lead,
    )  # fmt: skip
    if header.flags & CLOUD:
        listed = sweep if static is None else alone(sweep, movable_mask(static, sweep, sensor))
        fields = streams[5] if as_field else None
        listed = decode_logged(listed, sensor, streams[8], fields, models.envelope, told)
        sweep = replace(listed, stray_index=places, lead=lead)
    if header.flags & CLASSES:
        if header.flags & CLOUD:
            stray_labels, used = decode_stray_classes(sweep, streams[7])
        else:
            stray_labels, used = _read_plain_classes(s, classes)
        if len(stray_labels) < s:
            raise ArchiveError("payload does not decode")
        labels = checked(class_coder.decode_classes(starts, tick, models.classes, classes[used:]))
        sweep = replace(sweep, classes=labels, stray_classes=stray_labels)
    if content_crc(sweep) != header.content_crc:
        raise ArchiveError("payload decodes to something else than was coded (checksum differs)")
    models.remember(sweep)
    return sweep
