"""Label the sweeps of a GOP with the network; where nothing may be dropped, only the paper's planes ask for the ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import source_places, sweep_to_scan
from salpcc.stages.segment.geometric import split_ground
from salpcc.stages.segment.weights_file import any_sensor, weights_path

if TYPE_CHECKING:
    from salpcc.stages.segment.segmenter import Segmentation

_LONGEST_STEP = 250_000_000  # nanoseconds between scans without a gap


def label_gop(sweeps: Sequence[Sweep], sensor: SensorModel, config: RunConfig) -> list[Sweep]:
    """Return the sweeps with the classes that the task asks for; those that have labels already keep them.

    Raises:
        WeightsError: the network is asked and its weights cannot be had.
    """
    unasked = config.keep_movable and config.profile == "sensor" and not config.uses_network
    if unasked or all(sweep.classes is not None for sweep in sweeps):
        return list(sweeps)
    if not config.uses_network:
        return [
            sweep
            if sweep.classes is not None
            else with_classes(sweep, sensor, split_ground(sweep_to_scan(sweep, sensor).points))
            for sweep in sweeps
        ]
    return _by_network(sweeps, sensor, config)


def _by_network(sweeps: Sequence[Sweep], sensor: SensorModel, config: RunConfig) -> list[Sweep]:
    scans = (sweep_to_scan(sweep, sensor) for sweep in sweeps)
    motions = [sweep.motion for sweep in sweeps]
    found = network_classes(
        scans, joined(sweeps), motions, config.weights, config.device, config.several_scans
    )
    return [
        sweep if sweep.classes is not None else with_classes(sweep, sensor, classes)
        for sweep, classes in zip(sweeps, found, strict=True)
    ]


def network_classes(
    scans: Iterable[Scan],
    follows: Sequence[bool],
    motions: Sequence[NDArray[np.float64] | None],
    weights: str,
    device: str = "cpu",
    several_scans: bool = True,
) -> list[NDArray[np.uint8]]:
    """Ask the network what the points of the scans of a group are; return the classes ``(N,)`` of each.

    Clouds with other rings than the 64-laser sensor's, or without intensities, are asked of the weights for any sensor.

    Args:
        follows: whether each scan follows the one before it without a gap, as :func:`joined` tells.
        motions: each scan's own, or None.

    Raises:
        WeightsError: its weights cannot be had.
    """
    # Imported here: a process that asks no network has no use for torch's hundred megabytes.
    from salpcc.stages.segment.network.checkpoint import load_cached
    from salpcc.stages.segment.network.projection import project
    from salpcc.stages.segment.network.view import view_of
    from salpcc.stages.segment.segmenter import segment_image

    clouds = [(scan.points, scan.intensity) for scan in scans]
    view = view_of(clouds)
    images = [project(points, intensity, view) for points, intensity in clouds]
    path = weights_path(weights)
    if view.unlit or any(image.filled for image in images):
        path = any_sensor(path)
    network = load_cached(path, device)
    found = [segment_image(network, image) for image in images]
    return [one.labels() for one in judge_group(found, follows, motions, several_scans)]


def judge_group(
    found: Sequence[Segmentation],
    follows: Sequence[bool],
    motions: Sequence[NDArray[np.float64] | None],
    several_scans: bool = True,
) -> list[Segmentation]:
    """Settle what the network said of each scan of a group by what it said of those around, then object by object.

    Args:
        found: in order of time.
        follows, motions: as in :func:`network_classes`.
        several_scans: whether scans hear each other; else only objects are judged.
    """
    from salpcc.stages.segment.objects import judge_objects
    from salpcc.stages.segment.registration import steps_between
    from salpcc.stages.segment.several_scans import agree

    if not several_scans:
        return judge_objects(found, [None] * len(found))
    steps = steps_between(found, follows, motions)
    return judge_objects(agree(found, steps), steps)


def with_classes(sweep: Sweep, sensor: SensorModel, classes: NDArray[np.uint8]) -> Sweep:
    """Give a sweep the classes ``(N,)`` of its points, which are in file order."""
    on, off = source_places(sweep, sensor)
    return replace(sweep, classes=classes[on], stray_classes=classes[off])


def joined(sweeps: Sequence[Sweep] | Sequence[Scan]) -> list[bool]:
    """Tell of each sweep, or scan, whether it follows the one before it without a gap."""
    times = [sweep.time for sweep in sweeps]
    return [k > 0 and 0 < times[k] - times[k - 1] < _LONGEST_STEP for k in range(len(times))]
