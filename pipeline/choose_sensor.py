"""Which shipped sensor model a log is of: tried on the first clouds of its topics."""

from __future__ import annotations

import warnings
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import LogWarning, SourceError
from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.lattice.aim import share_on
from salpcc.stages.lattice.sensor_model import SENSORS, load_sensor

AUTO, OTHERWISE = "auto", "hdl64e"
_CLOUDS = 2  # of each topic
_LEAST = 0.5  # of the returns that must lie on the lattice


def choose_sensor(log: Path, sequence: str, topics: tuple[str, ...]) -> tuple[str, float | None]:
    """Return the name of the shipped model on whose lattice most returns of the first clouds lie, and their share.

    OTHERWISE, and 0, where no model holds for half of them; None where nothing can be read: the run will say why, and
    what of the log stays behind.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        clouds = _first_clouds(log, sequence, topics)
    if not clouds:
        return OTHERWISE, None
    best = OTHERWISE, 0.0
    for file in sorted(SENSORS.glob("*.json")):
        sensor = load_sensor(file.stem)
        share = float(np.mean([share_on(sensor, points) for points in clouds]))
        if share > max(best[1], _LEAST):
            best = file.stem, share
    return best


def _first_clouds(log: Path, sequence: str, topics: tuple[str, ...]) -> list[NDArray[np.float32]]:
    """The points of the first clouds of each topic that can be read and are not empty."""
    bag = Bag()
    try:
        refs = bag.scans(log, sequence, topics)
    except SourceError:  # the run will say so
        return []
    clouds: list[NDArray[np.float32]] = []
    for topic in sorted({ref.topic for ref in refs}):
        for ref in islice((ref for ref in refs if ref.topic == topic), _CLOUDS):
            try:
                scan = bag.read(ref, with_labels=False)
            except SourceError:
                continue
            if len(scan):
                clouds.append(scan.points)
    return clouds
