"""Tune the carving on one's own scans: movers are pasted into a stretch of them, and each setting is scored by what it takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.stages.mapping.carve import contradicted, evidence
from salpcc.stages.mapping.config import Carving, MapConfig
from salpcc.stages.mapping.drive.poses import move
from salpcc.stages.mapping.gather import gather, in_range, still
from salpcc.stages.mapping.paste import ground_under, movers_of, paste
from salpcc.stages.mapping.score import MOVING, STATIC, UNKNOWN, Truth, quality, tally
from salpcc.stages.mapping.voxel import keys_of

F64 = NDArray[np.float64]

STRETCH = 40  # scans that movers are pasted into
_MOVERS, _SEED = 8, 20
_VIEWS, _PER_MEETING, _MARGINS = (2, 3), (1.0, 2.0, 4.0), (0.15, 0.3, 0.6)
_HARDLY = 0.001  # of AA, below which another setting than the one in hand is no better


@dataclass(frozen=True)
class Trial:
    """A setting, and the shares of what stands that stay, and of what was pasted that go."""

    carving: Carving
    sa: float
    da: float

    @property
    def aa(self) -> float:
        """The root of their product."""
        return float(np.sqrt(self.sa * self.da))


def tune(scans: Sequence[Scan], poses: F64, motions: F64, config: MapConfig) -> list[Trial]:
    """Score all settings on a stretch of scans, each with its pose ``(n, 4, 4)`` and motion ``(n, 6)``; the best comes first.

    There are none where nothing that was pasted was seen.
    """
    ground = float(np.median([ground_under(scan.points.astype(np.float64)) for scan in scans]))
    movers = movers_of(poses, ground, _MOVERS, _SEED)
    truths: list[Truth] = []

    def pasted() -> Iterator[Scan]:
        for k, (scan, pose, motion) in enumerate(zip(scans, poses, motions, strict=True)):
            points, hit = paste(still(scan, motion), pose, movers, k)
            kept = in_range(points.astype(np.float32), config)
            truth = np.where(hit, MOVING, STATIC).astype(np.uint8)
            classes = scan.classes
            if classes is not None:
                truth[(GROUP_OF_CLASS[classes] == MOVABLE) & ~hit] = UNKNOWN
                classes = np.where(hit, 0, classes).astype(np.uint8)  # unlabelled: only free space tells
            truths.append(Truth.of_points(move(points[kept], pose), truth[kept], config.voxel))
            yield replace(scan, points=points.astype(np.float32), classes=classes)

    submap = gather(pasted(), poses, np.zeros_like(motions), config.model_copy(update={"carve": True}))
    whole, keys = Truth.together(truths), keys_of(submap.voxels.xyz, config.voxel)
    trials = []
    for margin in _MARGINS:
        seen = evidence(submap.voxels.xyz, submap.views, Carving(views=1, per_meeting=1.0, margin=margin))
        for views, per_meeting in product(_VIEWS, _PER_MEETING):
            how = Carving(views=views, per_meeting=per_meeting, margin=margin)
            left = keys[~contradicted(submap.voxels, *seen, how)]
            moving = quality(tally(whole, left, config.voxel))["moving"]
            if moving["SA"] is not None and moving["DA"] is not None:
                trials.append(Trial(how, moving["SA"], moving["DA"]))
    return sorted(trials, key=lambda trial: -trial.aa)


def best(trials: Sequence[Trial], before: Carving) -> Carving:
    """Choose a setting: the best, or the one ``before`` where that is hardly worse."""
    own = next((trial for trial in trials if trial.carving == before), None)
    if not trials or (own is not None and own.aa >= trials[0].aa - _HARDLY):
        return before
    return trials[0].carving
