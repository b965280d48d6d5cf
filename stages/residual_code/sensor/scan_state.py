"""What is known of one scan while it is coded: what the encoders of its streams read, what its decoders leave for each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.number_forms import spans_as, spans_of
from salpcc.stages.ingest.point_cloud import times_of
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.layers import Layered, alone, movable_mask
from salpcc.stages.lattice.publish import Rounded, rounded
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.aimed.aimed_layers import Among
from salpcc.stages.lists.list_coder import Plan, Told
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.predict.hundredths import intensity_levels
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.residual_code.message import logged_scan
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.header import CLOUD, FLOAT_INTENSITY, Header
from salpcc.stages.residual_code.sensor.value_models import ValueModels

_PATIENCE = 2  # scans of a group whose points are sought by their times in vain: a search takes seconds


def among_source(n: int, own: NDArray[np.int64] | int, static: Sweep | None, width: int = 1) -> Among:
    """Return where points of a layer stand among the ``n`` of an organised cloud.

    Args:
        own: their places, or how many they are.
        static: the static layer, where they are of the movable one.
        width: of a row, which a writer knows.
    """
    if static is None:
        return Among.of_source(n, own, width)
    assert static.source is not None
    return Among.of_source(n, own, width, (static.source, static.stray_points[:, :3]))


def points_beside(static: Sweep | None) -> NDArray[np.float32] | None:
    """Return the points ``(T, 3)`` of a static layer that is nothing but strays; None of another, or without one."""
    if static is None or len(static.laser):
        return None
    return np.ascontiguousarray(static.stray_points[:, :3])


def _lanes_of(cloud: Cloud | None) -> NDArray[np.uint8] | None:
    """Return the laser ``(N,)`` that a message tells of each point; None where it tells none, or more than bytes do."""
    rings = None if cloud is None else cloud.rings()
    return None if rings is None or rings.max(initial=0) > 255 else rings.astype(np.uint8)


def timed_beside(
    static: Sweep | None, own: Cloud | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]] | None:
    """Return lasers and times ``(T,)`` that the message of a static layer tells, and the times that ``own`` tells, from the same origin; None where it tells none."""
    cloud = None if static is None else static.cloud
    lanes = _lanes_of(cloud)
    if cloud is None or cloud.time_field is None or lanes is None:
        return None
    spans = spans_of(cloud.values(cloud.time_field))
    if spans is None:
        return None
    times = np.zeros(0, np.int64)
    if own is not None:
        theirs = spans_as(own.values(cloud.time_field), spans.form, spans.power, spans.origin)
        if theirs is None:
            return None
        times = theirs.low
    return lanes, spans.low, times


@dataclass
class Encoding:
    """One scan while it is encoded: ``flags`` and ``reach`` are for its header, the streams set them.

    Args:
        static: the static layer, where ``sweep`` is the movable one.
    """

    sweep: Sweep
    sensor: SensorModel
    predicted: Prediction
    state: GopState
    static: Sweep | None
    flags: int = 0
    reach: list[float] = field(default_factory=lambda: [-1.0, -1.0])  # of millimetres, of float32

    @cached_property
    def values(self) -> ValueModels:
        return self.state.values(self.predicted.effort)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        return ring_starts(self.sweep.laser, self.sensor.n_lasers)

    @cached_property
    def rounded(self) -> Rounded:
        """The returns on their way from the model to the file."""
        sweep = self.sweep
        model = unproject(self.sensor, sweep.laser, sweep.tick, sweep.count)
        return rounded(model, sweep.millimetre, sweep.motion)

    @cached_property
    def listed(self) -> Sweep:
        """The sweep as its message lists it: what lies in file order, a layer has in the order of its own points."""
        if self.layered is None or self.sweep.cloud is None:
            return self.sweep
        return alone(self.sweep, self.layered.movable)

    @cached_property
    def layered(self) -> Layered | None:
        """Which points of both layers the movable one has; None where the sweep is none."""
        if self.static is None:
            return None
        return Layered(self.static, movable_mask(self.static, self.sweep, self.sensor))

    @property
    def topic(self) -> str:
        return "" if self.sweep.cloud is None else self.sweep.cloud.topic

    @cached_property
    def strays(self) -> Plan:
        """How the strays are coded."""
        sweep = self.sweep
        # Of points without a lattice, by their place in the list, which a movable layer's have not.
        moved = sweep.motion if len(sweep.laser) == 0 and self.static is None else None
        listed = _lanes_of(self.listed.cloud)
        lanes = None if listed is None else listed[self.listed.stray_index]
        times = None
        if sweep.cloud is not None and len(sweep.laser) == 0 and self.state.timeless < _PATIENCE:
            times = times_of(self.listed.cloud)  # type: ignore[arg-type]
        among, beside = None, points_beside(self.static)
        if sweep.source is not None:
            width = 1 if sweep.cloud is None else sweep.cloud.layout.width
            among = among_source(sweep.n_points, sweep.source, self.static, width)
        elif self.layered is not None and beside is not None and len(sweep.laser) == 0:
            timed = partial(timed_beside, self.static, self.listed.cloud)
            among = Among.of_list(len(sweep), beside, self.layered.movable, timed)
        found = plan(
            sweep.stray_points[:, :3], sweep.max_error, self.sensor, moved,
            lanes=lanes, times=times, like=self.state.layouts.get(self.topic, (None, 0.0))[0],
            turning=self.state.turning.get(self.topic),
            moved_by=self.state.moved_by.get(self.topic),
            learned=self.state.lists.of_topic(self.topic) if self.state.learns else None,
            among=among,
        )  # fmt: skip
        if found.turning is not None:
            self.state.turning[self.topic] = found.turning
        if found.moved_by is not None:
            self.state.moved_by[self.topic] = found.moved_by
        if times is not None:
            self.state.timeless = 0 if found.coded is not None else self.state.timeless + 1
        return found

    @cached_property
    def logged(self) -> tuple[Scan, Points]:
        """The message's scan, and what its fields are predicted from."""
        told = self.strays.told if len(self.sweep.laser) == 0 else None
        return logged_scan.known_of(self.listed, self.sensor, told, self.layered)

    @cached_property
    def levels(self) -> NDArray[np.uint8] | None:
        """Intensities in hundredths ``(M,)``, as the sensor's own models take them; None if they are not."""
        return intensity_levels(self.sweep.intensity)

    @property
    def intensity_is_field(self) -> bool:
        return logged_scan.intensity_is_field(self.sweep, self.levels)


@dataclass
class Decoding:
    """One scan while it is decoded: what the header tells, and what the streams have told so far."""

    header: Header
    sensor: SensorModel
    state: GopState
    static: Sweep | None
    sweep: Sweep
    streams: dict[str, bytes]
    starts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    hundredths: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))  # intensities
    told: Told = None  # what the stream of the points tells of them besides
    field_of_intensity: bytes = b""  # the stream of intensities where the cloud tells how to read it

    @cached_property
    def values(self) -> ValueModels:
        return self.state.known(self.header.effort, self.header.weights)

    @cached_property
    def before(self) -> WarpedSweep | None:
        return self.state.warped(self.header.effort, self.sweep.motion)

    @cached_property
    def model(self) -> NDArray[np.float64]:
        return unproject(self.sensor, self.sweep.laser, self.sweep.tick, self.sweep.count)

    @property
    def intensity_is_field(self) -> bool:
        return bool(self.header.flags & CLOUD and self.header.flags & FLOAT_INTENSITY)
