"""Our own codec under the contract of the baselines, so that it stands on the same curves.

``encode`` and ``decode`` take one scan, which the codec then knows without its neighbours in time; a group of
scans goes through :func:`encode_group` and :func:`decode_group`. Nothing is dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from salpcc.schemas.config import Effort, RunConfig
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines.baseline import Baseline, Points, Promise


@dataclass(frozen=True)
class Coded:
    """One coded scan: its payload, and the bytes of each stream in it."""

    data: bytes
    geometry: int
    intensity: int
    side: int


def encode_group(scans: Sequence[Scan], max_error: float, effort: Effort = "default") -> list[Coded]:
    """Encode consecutive scans as one group, through the very stages that a run goes through.

    An error of 0 is bit-exact; above, no point is farther than that from its source.
    """
    bare = [Scan(scan.name, scan.points, scan.intensity) for scan in scans]
    return _encode(bare, {"max_error": max_error or None, "keep_movable": True, "effort": effort})


def encode_static_layer(scans: Sequence[Scan], max_error: float, effort: Effort = "default") -> list[Coded]:
    """Encode consecutive scans as one group in two layers, by their own classes; return the static one."""
    return _encode(scans, {"max_error": max_error or None, "labels": "given", "effort": effort})


def _encode(scans: Sequence[Scan], config: dict[str, Any]) -> list[Coded]:
    from salpcc.stages.coding import code

    table = code(enumerate(scans), RunConfig.model_validate(config))["residual_code"]
    return [Coded(r["data"], r["geometry"], r["intensity"], r["side"]) for r in table.to_pylist()]


def decode_group(payloads: Iterable[bytes]) -> Iterator[Scan]:
    """Decode a group's payloads, in their order."""
    from salpcc.stages.lattice.sensor_model import load_sensor
    from salpcc.stages.lattice.sweep import sweep_to_scan
    from salpcc.stages.residual_code.gop import decode_gop

    sensor = load_sensor(RunConfig.model_validate({}).sensor)
    return (sweep_to_scan(sweep, sensor) for sweep in decode_gop(payloads, sensor))


def encode(points: Points, max_error: float) -> bytes:
    """Encode one scan; one byte with the number of columns stands in front."""
    intensity = points[:, 3] if points.shape[1] == 4 else np.zeros(len(points), np.float32)
    scan = Scan("000000", np.ascontiguousarray(points[:, :3]), np.ascontiguousarray(intensity))
    return bytes([points.shape[1]]) + encode_group([scan], max_error)[0].data


def decode(data: bytes) -> Points:
    """Decode one scan."""
    scan = next(decode_group([data[1:]]))
    return np.column_stack([scan.points, scan.intensity])[:, : data[0]].astype(np.float32, copy=False)


def geometry_bytes(data: bytes) -> int:
    """Bytes of one coded scan that are not intensity or classes."""
    from salpcc.stages.residual_code.sensor.payload import unpack

    _, streams = unpack(data[1:])
    return len(data) - sum(len(streams[name]) for name in ("intensity", "stray_intensity", "classes"))


SALPCC = Baseline(
    title="salpcc, one scan at a time",
    packages=(),
    promise=Promise(bound="distance", order=True, count=True, intensity=True),
    encode=encode,
    decode=decode,
    geometry=geometry_bytes,
)
