"""The streams of a scan: one row each in the table at the end, its encoder and decoder side by side above it.

An encoder reads what :class:`.scan_state.Encoding` knows and returns the bytes of its stream. A decoder takes these bytes, and what the
rows before it left in :class:`.scan_state.Decoding`, and leaves its own values there.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, require_sound, run_encoder
from salpcc.stages.entropy.integers import decode_column, encode_column
from salpcc.stages.lattice.lattice import NO_CORRECTION
from salpcc.stages.lattice.layers import Layered, alone, movable_mask
from salpcc.stages.lattice.publish import Rounded, rounded
from salpcc.stages.lists.aimed.aimed_layers import Among
from salpcc.stages.lists.list_coder import decode_list, encode_list, learned_number
from salpcc.stages.lists.list_values import decode_values, encode_values
from salpcc.stages.lists.timeline import Timeline
from salpcc.stages.predict.hundredths import INTENSITY_OF_LEVEL
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.message import logged_scan
from salpcc.stages.residual_code.sensor import correction_coder, layer_mask_coder, mask_coder
from salpcc.stages.residual_code.sensor.correction_coder import FLOAT32, MILLIMETRE
from salpcc.stages.residual_code.sensor.header import CLASSES, CLOUD, FLOAT_INTENSITY, LAYER, SOURCE
from salpcc.stages.residual_code.sensor.scan_state import (
    Decoding,
    Encoding,
    among_source,
    points_beside,
    timed_beside,
)
from salpcc.stages.residual_code.stream import Stream

Data = NDArray[np.uint8]
_LENGTH = struct.Struct("<I")
_MORE = 1.05  # times as many bytes a point as when the layout of a list was searched for; then it is again


# Which firings returned.


def _encode_mask(scan: Encoding) -> bytes:
    sensor, state, tick, static = scan.sensor, scan.state, scan.sweep.tick, scan.static
    turn = sensor.shift, sensor.ticks_per_turn
    if static is None:
        return run_encoder(
            lambda out: mask_coder.encode_mask(scan.starts, tick, *turn, state.firing, state.mask, out),
            len(tick),
            state.firing,
            state.mask,
        )
    known = ring_starts(static.laser, sensor.n_lasers), static.tick
    return run_encoder(
        lambda out: layer_mask_coder.encode_layer_mask(
            *known, scan.starts, tick, *turn, state.layer_firing, state.layer_mask, out
        ),
        len(tick),
        state.layer_firing,
        state.layer_mask,
    )


def _decode_mask(scan: Decoding, stream: bytes) -> None:
    sensor, state, static, n = scan.sensor, scan.state, scan.static, scan.header.returns
    turn = sensor.shift, sensor.ticks_per_turn
    if static is None:
        laser, tick, sound = mask_coder.decode_mask(*turn, n, state.firing, state.mask, as_array(stream))
    else:
        known = ring_starts(static.laser, sensor.n_lasers), static.tick
        laser, tick, sound = layer_mask_coder.decode_layer_mask(
            *known, *turn, n, state.layer_firing, state.layer_mask, as_array(stream)
        )
    require_sound(sound)
    scan.sweep = replace(scan.sweep, laser=laser, tick=tick)
    scan.starts = ring_starts(laser, sensor.n_lasers)


# How far they came from.


def _encode_levels(scan: Encoding) -> bytes:
    return scan.values.encode_levels(scan.sweep, scan.predicted)


def _decode_levels(scan: Decoding, stream: bytes) -> None:
    """Decode the levels, and with them the intensities that are hundredths."""
    floats = scan.header.flags & FLOAT_INTENSITY
    intensities = None if floats else as_array(scan.streams["intensity"])
    count, scan.hundredths, sound = scan.values.decode(
        scan.starts, scan.sweep.tick, scan.header.step, scan.before, as_array(stream), intensities
    )
    require_sound(sound)
    scan.sweep = replace(scan.sweep, count=count)


# What rounding to millimetres, and to float32, did otherwise than ours.


def _encode_millimetre(scan: Encoding) -> bytes:
    if scan.sweep.max_error > 0:
        return b""
    return _corrections(scan, MILLIMETRE, scan.rounded, scan.sweep.millimetre, scan.state.millimetre)


def _decode_millimetre(scan: Decoding, stream: bytes) -> None:
    reach, codes = scan.header.millimetre_reach, np.full(scan.header.returns, NO_CORRECTION, np.uint8)
    if scan.header.max_error == 0 and reach >= 0:
        codes, sound = correction_coder.decode_corrections(
            MILLIMETRE, rounded(scan.model, codes, None), reach, scan.state.millimetre, as_array(stream)
        )
        require_sound(sound)
    scan.sweep = replace(scan.sweep, millimetre=codes)


def _encode_ulp(scan: Encoding) -> bytes:
    sweep = scan.sweep
    if sweep.max_error > 0:
        return b""
    return _corrections(scan, FLOAT32, scan.rounded, sweep.ulp, scan.state.ulp)


def _decode_ulp(scan: Decoding, stream: bytes) -> None:
    reach, codes = scan.header.ulp_reach, np.full(scan.header.returns, NO_CORRECTION, np.uint8)
    if scan.header.max_error == 0 and reach >= 0:
        given = rounded(scan.model, scan.sweep.millimetre, scan.sweep.motion)
        codes, sound = correction_coder.decode_corrections(
            FLOAT32, given, reach, scan.state.ulp, as_array(stream)
        )
        require_sound(sound)
    scan.sweep = replace(scan.sweep, ulp=codes)


def _corrections(
    scan: Encoding, rounding: int, given: Rounded, codes: Data, bits: NDArray[np.uint16]
) -> bytes:
    scan.reach[rounding] = reach = correction_coder.correction_reach(rounding, given, codes)
    if reach < 0:
        return b""
    return run_encoder(
        lambda out: correction_coder.encode_corrections(rounding, given, reach, codes, bits, out),
        len(codes),
        bits,
    )


# Points off the lattice, and where they stand in the file.


def _encode_strays(scan: Encoding) -> bytes:
    if scan.sweep.source is not None:
        scan.flags |= SOURCE
    stream = _written_strays(scan)
    if number := learned_number(stream):
        scan.state.lists.settle(number)
    return stream


def _written_strays(scan: Encoding) -> bytes:
    index, layouts = scan.sweep.stray_index, scan.state.layouts
    index = index if scan.sweep.source is None else scan.sweep.source
    stream = encode_list(index, scan.strays)
    if len(scan.sweep.laser) or not len(index):  # not all points of a scan, in their order
        return stream
    if scan.topic in layouts:
        if len(stream) <= _MORE * layouts[scan.topic][1] * len(index):
            return stream
        del layouts[scan.topic], scan.strays
        scan.state.turning.pop(scan.topic, None)
        scan.state.moved_by.pop(scan.topic, None)
        stream = encode_list(index, scan.strays)
    layouts[scan.topic] = scan.strays.layout, len(stream) / len(index)
    return stream


def _decode_strays(scan: Decoding, stream: bytes) -> None:
    header, sweep = scan.header, scan.sweep
    moved = header.motion if header.returns == 0 else None
    static = scan.static
    among, source, beside = None, None, points_beside(static)
    if header.flags & SOURCE:
        of_both = header.strays + (0 if static is None else len(static))
        require_sound(header.n_points >= of_both)
        require_sound(static is None or (static.source is not None and static.n_points == header.n_points))
        among = among_source(header.n_points, header.strays, static)
    elif beside is not None and header.returns == 0:
        among = Among.of_list(header.strays, beside, timed=partial(timed_beside, static))
    places, points, told, sound = decode_list(
        header.strays,
        header.max_error,
        as_array(stream),
        scan.sensor,
        moved,
        scan.state.lists,
        among,
    )
    require_sound(sound)
    if isinstance(told, Timeline):
        require_sound(header.returns == 0, header.flags & CLOUD)
    scan.told = told if header.returns == 0 else None
    of_all = header.returns + header.strays + (0 if static is None else len(static))
    if header.flags & SOURCE:
        of_all = header.n_points
    if header.strays:
        require_sound(places[0] >= 0, places[-1] < of_all, (np.diff(places) > 0).all())
    if header.flags & SOURCE:
        source = places
        kept = np.zeros(header.n_points, np.bool_)
        if static is not None and static.source is not None:
            kept[static.source] = True
        require_sound(not kept[source].any())
        kept[source] = True
        places = (np.cumsum(kept) - 1)[source]
    points = np.column_stack([points, np.zeros(header.strays, np.float32)])
    scan.sweep = replace(sweep, stray_index=places, stray_points=points, source=source)


# Intensities of returns: hundredths, any float, or a field of the recorded message, strays' included.


def _encode_intensity(scan: Encoding) -> bytes:
    if scan.intensity_is_field:
        scan.flags |= FLOAT_INTENSITY
        return logged_scan.encode_intensity(scan.listed, scan.logged, scan.state.fields)
    if scan.levels is None:
        scan.flags |= FLOAT_INTENSITY
        floats = scan.sweep.intensity
        return run_encoder(lambda out: encode_values(floats, (1, 0), out), len(floats))
    return scan.values.encode_intensity(scan.levels, scan.predicted)


def _decode_intensity(scan: Decoding, stream: bytes) -> None:
    n, sweep = scan.header.returns, scan.sweep
    if scan.intensity_is_field:
        scan.field_of_intensity = stream
        floats = np.zeros(n, np.float32)
    elif scan.header.flags & FLOAT_INTENSITY:
        floats, sound = decode_values(n, as_array(stream))
        require_sound(sound)
    else:
        floats = INTENSITY_OF_LEVEL.take(scan.hundredths)
    scan.sweep = replace(sweep, intensity=floats)


def _encode_stray_intensity(scan: Encoding) -> bytes:
    if scan.intensity_is_field:
        return b""
    fourth = scan.sweep.stray_points[:, 3]
    return run_encoder(lambda out: encode_values(fourth, scan.strays.layout, out), len(fourth))


def _decode_stray_intensity(scan: Decoding, stream: bytes) -> None:
    if not scan.intensity_is_field:
        fourth, sound = decode_values(scan.header.strays, as_array(stream))
        require_sound(sound)
        scan.sweep.stray_points[:, 3] = fourth


# The order of both layers' points.


def _encode_lead(scan: Encoding) -> bytes:
    """How many returns of the movable layer stand before each stray of the static one; nothing for zeros."""
    lead = scan.sweep.lead
    if scan.static is not None:
        scan.flags |= LAYER
    if lead is None or not lead.any():
        return b""
    return encode_column(lead)


def _decode_lead(scan: Decoding, stream: bytes) -> None:
    if scan.static is None:
        return
    n = len(scan.static.stray_index)
    lead = np.zeros(n, np.int64)
    if stream:
        lead, sound = decode_column(n, as_array(stream))
        require_sound(sound)
    scan.sweep = replace(scan.sweep, lead=lead)


# What else the message of a log holds.


def _encode_cloud(scan: Encoding) -> bytes:
    if scan.sweep.cloud is None:
        return b""
    scan.flags |= CLOUD
    in_slot = scan.sweep.cloud.layout.slots[3] is not None
    stream, listed = logged_scan.encode_logged(
        scan.listed,
        scan.logged,
        scan.state.envelope,
        scan.state.fields,
        scan.intensity_is_field and in_slot,
    )
    scan.sweep = replace(scan.sweep, cloud=listed.cloud)
    return stream


def _decode_cloud(scan: Decoding, stream: bytes) -> None:
    if not scan.header.flags & CLOUD:
        return
    sweep, static = scan.sweep, scan.static
    listed, layered = sweep, None
    if static is not None:
        layered = Layered(static, movable_mask(static, sweep, scan.sensor))
        listed = alone(sweep, layered.movable)
    of_field = scan.field_of_intensity if scan.intensity_is_field else None
    found = logged_scan.decode_logged(
        listed, scan.sensor, stream, of_field, scan.state.envelope, scan.state.fields, scan.told, layered
    )
    scan.sweep = replace(found, stray_index=sweep.stray_index, source=sweep.source, lead=sweep.lead)


# Classes of the strays, then of the returns.


def _encode_classes(scan: Encoding) -> bytes:
    sweep = scan.sweep
    if sweep.classes is None or sweep.stray_classes is None:
        return b""
    scan.flags |= CLASSES
    classes, of_strays = sweep.classes, b""
    if sweep.cloud is not None:
        of_strays = logged_scan.encode_stray_classes(sweep)
    elif len(sweep.stray_classes):
        values, layout = sweep.stray_classes.astype(np.float32), scan.strays.layout
        of_strays = run_encoder(lambda out: encode_values(values, layout, out), len(values))
        of_strays = _LENGTH.pack(len(of_strays)) + of_strays
    return of_strays + run_encoder(
        lambda out: class_coder.encode_classes(scan.starts, sweep.tick, classes, scan.state.classes, out),
        len(classes),
        scan.state.classes,
    )


def _decode_classes(scan: Decoding, stream: bytes) -> None:
    if not scan.header.flags & CLASSES:
        return
    strays, used = scan.header.strays, 0
    of_strays = np.zeros(0, np.uint8)
    if scan.header.flags & CLOUD:
        of_strays, used = logged_scan.decode_stray_classes(scan.sweep, stream)
        require_sound(len(of_strays) == strays)
    elif strays:
        require_sound(len(stream) >= _LENGTH.size)
        used = _LENGTH.size + _LENGTH.unpack_from(stream)[0]
        values, sound = decode_values(strays, as_array(stream[_LENGTH.size : used]))
        require_sound(sound, used <= len(stream), (values >= 0).all(), (values <= 255).all())
        of_strays = values.astype(np.uint8)
    classes, sound = class_coder.decode_classes(
        scan.starts, scan.sweep.tick, scan.state.classes, as_array(stream[used:])
    )
    require_sound(sound)
    scan.sweep = replace(scan.sweep, classes=classes, stray_classes=of_strays)


# Decoders run in this order: each needs what the ones above it found.
STREAMS: tuple[Stream[Encoding, Decoding], ...] = (
    Stream("mask", 0, "geometry", _encode_mask, _decode_mask),
    Stream("levels", 1, "geometry", _encode_levels, _decode_levels),
    Stream("millimetre", 2, "geometry", _encode_millimetre, _decode_millimetre),
    Stream("ulp", 3, "geometry", _encode_ulp, _decode_ulp),
    Stream("stray_points", 4, "geometry", _encode_strays, _decode_strays),
    Stream("intensity", 5, "intensity", _encode_intensity, _decode_intensity),
    Stream("stray_intensity", 6, "intensity", _encode_stray_intensity, _decode_stray_intensity),
    Stream("lead", 9, "geometry", _encode_lead, _decode_lead, LAYER),
    Stream("cloud", 8, "side", _encode_cloud, _decode_cloud, CLOUD),
    Stream("classes", 7, "classes", _encode_classes, _decode_classes),
)
