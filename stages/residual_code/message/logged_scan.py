"""What the payload of a recorded message adds to that of a bare scan: the cloud, and its intensities.

Intensities that the models of a known sensor do not cover are a field like any other, in file order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.ingest.point_cloud import intensity_of
from salpcc.stages.lattice.layers import Layered
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import source_places, sweep_to_scan
from salpcc.stages.lists.list_coder import Told
from salpcc.stages.residual_code.message.cloud_coder import decode_cloud, encode_cloud, points_of
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import INTENSITY, REFLECTIVITY, Points

_FEW = 20  # of so many points one: a record of its own would take more than it tells


def intensity_is_field(sweep: Sweep, levels: NDArray[np.uint8] | None) -> bool:
    """Tell whether intensities are coded here; ``levels``: as the sensor's own models take them, or None."""
    if sweep.cloud is None:
        return False
    return levels is None or len(sweep.laser) == 0 or sweep.cloud.layout.slots[3] is None


def known_of(
    sweep: Sweep, sensor: SensorModel, told: Told = None, layered: Layered | None = None
) -> tuple[Scan, Points]:
    """Return the scan of a logged sweep, and what its fields are predicted from.

    Args:
        told: by the points' own stream.
        layered: where the sweep is the movable layer.
    """
    assert sweep.cloud is not None
    scan = sweep_to_scan(sweep, sensor)
    return scan, points_of(scan.points, sweep.cloud, sensor, told, layered, sweep.source)


def encode_intensity(sweep: Sweep, known: tuple[Scan, Points], modes: FieldModes) -> bytes:
    """Encode float32 intensities of returns as a field; nothing where they are in the cloud anyway."""
    assert sweep.cloud is not None
    if sweep.cloud.layout.slots[3] is None:
        return b""
    scan, points = known
    values = scan.intensity if _dim(known) is None else np.where(points.void, np.float32(0), scan.intensity)
    return modes.encode((sweep.cloud.topic, INTENSITY), values, _guided(points, sweep.cloud))


def _dim(known: tuple[Scan, Points]) -> NDArray[np.float32] | None:
    """Intensities ``(N,)`` of points without a return, 0 of the others; None where few are other than 0."""
    scan, points = known
    lit = points.void & (scan.intensity.view(np.int32) != 0)
    if _FEW * np.count_nonzero(lit) <= len(lit):
        return None
    return np.where(points.void, scan.intensity, np.float32(0))


def _guided(points: Points, cloud: Cloud) -> Points:
    """What intensities are told from: reflectivities, too, which come before them."""
    field = next((c for c in cloud.layout.columns if c.name == REFLECTIVITY and c.dtype.kind in "iu"), None)
    return points if field is None else replace(points, guide=cloud.values(field).astype(np.int64))


def encode_logged(
    sweep: Sweep, known: tuple[Scan, Points], before: bytearray, modes: FieldModes, with_dim: bool
) -> tuple[bytes, Sweep]:
    """Encode the cloud of a sweep; return the stream, and the sweep as it will be decoded.

    Args:
        with_dim: intensities are coded by :func:`encode_intensity`, those of points without a return here.
    """
    assert sweep.cloud is not None
    scan, points = known
    dim = _dim(known) if with_dim else None
    stream, cloud = encode_cloud(sweep.cloud, scan.points, sweep.max_error == 0, before, points, modes, dim)
    return stream, replace(sweep, cloud=cloud)


def decode_logged(
    sweep: Sweep,
    sensor: SensorModel,
    stream: bytes,
    intensity: bytes | None,
    before: bytearray,
    modes: FieldModes,
    told: Told = None,
    layered: Layered | None = None,
) -> Sweep:
    """Return a decoded sweep with its cloud; inverse of :func:`encode_logged` and :func:`encode_intensity`.

    Args:
        intensity: the intensities' stream where they are coded here.
        layered: where the sweep is the movable layer.

    Raises:
        ArchiveError: a stream is damaged.
    """
    points = sweep_to_scan(sweep, sensor).points
    cloud, dim, known = decode_cloud(
        stream,
        sweep.n_points,
        points,
        sweep.max_error == 0,
        before,
        modes,
        sensor,
        told,
        layered,
        sweep.source,
    )
    sweep = replace(sweep, cloud=cloud)
    in_slot = intensity is not None and cloud.layout.slots[3] is not None
    require_sound(dim is None or in_slot)
    if intensity is None:
        return sweep
    if cloud.layout.slots[3] is None:
        values = intensity_of(cloud)
    else:
        known = _guided(known, cloud)
        name = (cloud.topic, INTENSITY)
        values, end = modes.decode(name, intensity, 0, np.dtype(np.float32), known)
        require_sound(end == len(intensity))
        values = values if dim is None else np.where(known.void, dim, values)
    on, off = source_places(sweep, sensor)
    strays = np.column_stack([sweep.stray_points[:, :3], values[off]])
    return replace(sweep, intensity=values[on], stray_points=strays)


def encode_stray_classes(sweep: Sweep) -> bytes:
    """Encode the classes of the strays as a field: the points of an unknown sensor are nothing but strays."""
    assert sweep.cloud is not None and sweep.stray_classes is not None
    return encode_field(sweep.stray_classes, points_of(sweep.stray_points[:, :3], sweep.cloud))


def decode_stray_classes(sweep: Sweep, stream: bytes) -> tuple[NDArray[np.uint8], int]:
    """Inverse of :func:`encode_stray_classes`: the classes, and the bytes that they took.

    Raises:
        ArchiveError: the stream is damaged.
    """
    assert sweep.cloud is not None
    points = points_of(sweep.stray_points[:, :3], sweep.cloud)
    return decode_field(stream, 0, np.dtype(np.uint8), points)
