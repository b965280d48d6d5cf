"""A group of pictures: its scans coded one after the other, with models that learn along the way.

The first scan of a GOP starts from fresh models, so a GOP decodes alone; within it a scan needs the
ones before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.prediction import predict
from salpcc.stages.residual_code.models import GopModels
from salpcc.stages.residual_code.payload import Payload
from salpcc.stages.residual_code.scan_coder import decode_scan, encode_scan


def encode_gop(sweeps: Iterable[Sweep], sensor: SensorModel, effort: str = "default") -> list[Payload]:
    """Encode the sweeps of one GOP, predictions included."""
    models = GopModels(sensor)
    return [encode_scan(sweep, sensor, predict(sweep, sensor, effort), models) for sweep in sweeps]


def decode_gop(payloads: Iterable[bytes], sensor: SensorModel) -> Iterator[Sweep]:
    """Decode the payloads of one GOP from its first scan on; inverse of :func:`encode_gop`.

    Raises:
        ArchiveError: a payload is damaged.
    """
    models = GopModels(sensor)
    for data in payloads:
        yield decode_scan(data, sensor, models)
