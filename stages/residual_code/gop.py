"""A group of pictures: its scans coded one after the other, with models that learn along the way.

The first scan of a GOP starts from fresh models, so a GOP decodes alone; within it a scan needs the
ones before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, repeat, zip_longest

from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.grid import GridSweep
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.paper_grid import grid_to_scan
from salpcc.stages.lattice.frame import Frame, sweep_in_frame
from salpcc.stages.lattice.layers import alone as of_its_own
from salpcc.stages.lattice.layers import both, movable_mask
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.values import predict_sweeps
from salpcc.stages.residual_code.paper.grid_coder import decode_grids
from salpcc.stages.residual_code.paper.grid_header import GRID_CODEC
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan, encode_scan
from salpcc.stages.residual_code.stream import Payload


def encode_gop(
    sweeps: Iterable[Sweep],
    sensor: SensorModel,
    effort: str = "default",
    predictions: Iterable[Prediction] | None = None,
    statics: Iterable[Sweep] | None = None,
) -> list[Payload]:
    """Encode the sweeps of one GOP.

    Args:
        predictions: of each sweep, made here where they are None.
        statics: the static layer of each sweep, where they are the movable ones.
    """
    group = list(sweeps)
    state = GopState(sensor, effort != "fast")
    predicted = predict_sweeps(group, sensor, effort) if predictions is None else predictions
    beside = repeat(None, len(group)) if statics is None else statics
    return [
        encode_scan(sweep, sensor, prediction, state, static)
        for sweep, prediction, static in zip(group, predicted, beside, strict=True)
    ]


def encode_layers(
    layers: Iterable[tuple[Sweep, Sweep | None]], sensor: SensorModel, effort: str = "default"
) -> list[tuple[Payload, Payload | None]]:
    """Encode the static and the movable layers of one GOP; those without a movable one are its last."""
    group = list(layers)
    pairs = [(static, movable) for static, movable in group if movable is not None]
    coded = encode_gop((static for static, _ in group), sensor, effort)
    moving = encode_gop((m for _, m in pairs), sensor, effort, statics=(static for static, _ in pairs))
    return list(zip_longest(coded, moving))


def decode_any(payloads: Iterable[bytes], sensor: SensorModel) -> Iterator[Sweep | GridSweep]:
    """Decode the payloads of one GOP of either profile, from its first scan on.

    Raises:
        ArchiveError: a payload is damaged.
        UsageError: they are of the profile ``paper``, and its extra is not installed.
    """
    coming = iter(payloads)
    first = next(coming, b"")
    given = chain([first], coming) if first else coming
    if first[:1] != bytes([GRID_CODEC]):
        return decode_gop(given, sensor)
    require("paper", "an archive of the profile paper")
    return decode_grids(given)


def scan_of(
    sweep: Sweep | GridSweep, sensor: SensorModel, frame: Frame = "recorded", turn_ns: int = 0
) -> Scan:
    """Return the scan of a decoded sweep of either profile, in a frame (:mod:`salpcc.stages.lattice.frame`).

    Raises:
        UsageError: the scan is in no frame but the recorded one.
    """
    if isinstance(sweep, GridSweep):
        if frame != "recorded":
            raise UsageError("the grid of the profile paper has no frame but --frame recorded")
        return grid_to_scan(sweep)
    return sweep_in_frame(sweep, sensor, frame, turn_ns, raw=len(sweep.laser) > 0)


def decode_gop(payloads: Iterable[bytes], sensor: SensorModel) -> Iterator[Sweep]:
    """Decode the payloads of one GOP from its first scan on; inverse of :func:`encode_gop`.

    Raises:
        ArchiveError: a payload is damaged.
    """
    state = GopState(sensor)
    for data in payloads:
        yield decode_scan(data, sensor, state)


def layered_scan(
    static: Sweep,
    movable: Sweep,
    sensor: SensorModel,
    alone: bool = False,
    frame: Frame = "recorded",
    turn_ns: int = 0,
) -> Scan:
    """Return the scan of two decoded layers, or (``alone``) of the movable one; frames as in :func:`scan_of`.

    Raises:
        ArchiveError: they do not fit one another.
        UsageError: as there.
    """
    raw = len(static.laser) > 0
    if alone:
        own = of_its_own(movable, movable_mask(static, movable, sensor))
        return sweep_in_frame(own, sensor, frame, turn_ns, raw)
    return both(static, movable, sensor, lambda layer: sweep_in_frame(layer, sensor, frame, turn_ns, raw))
