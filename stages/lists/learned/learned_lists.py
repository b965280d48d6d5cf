"""What efforts above ``fast`` learn of the lists of points of a group, topic by topic, and take along from scan to scan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.mixed_numbers import copied
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.learned.between import find_between
from salpcc.stages.lists.learned.learned_counts import (
    CountModels,
    CountSeen,
    new_count_models,
    no_counts,
)
from salpcc.stages.lists.learned.learned_order import OrderModels, OrderSeen, new_order_models, nothing_seen
from salpcc.stages.lists.learned.learned_rays import RayModels, RaySeen, new_ray_models, no_rays
from salpcc.stages.lists.learned.moved_sweep import Passing, Turn, no_turn, seen_later
from salpcc.stages.lists.learned.seen_rays import Eyes, Swept, swept_later
from salpcc.stages.lists.timeline import Passed

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MOST_LISTS = 15  # topics of a group that learn; the others are coded as ``fast`` does


class Known(NamedTuple):
    """Models, which adapt, and the sweep before: on the lattice, ``passing`` of a sensor whose motion is known, ``swept`` on rays; how many lists there were."""

    order: OrderModels
    counts: CountModels
    turn: Turn
    passing: Passing | None
    rays: RayModels | None
    swept: Swept | None
    lists: int


class Walk(NamedTuple):
    """What :func:`~salpcc.stages.lists.aimed.aimed_coder.code_aimed` takes: models, and what the scan shows; ``shuffled``: points of a laser come in no order of azimuths, and are put in it."""

    order: OrderModels
    heard: OrderSeen
    counts: CountModels
    counted: CountSeen
    shuffled: bool


class RayWalk(NamedTuple):
    """What :func:`~salpcc.stages.lists.timed.timed_coder.code_timed` takes: models, and what the scan shows."""

    models: RayModels
    seen: RaySeen


class Learned:
    """What was learned of the clouds of one topic; a writer tries things, so what it learned counts only once it is :meth:`settled`."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._known = Known(new_order_models(), new_count_models(), no_turn(), None, None, None, 0)
        self._tried = self._known
        self.passed: Passed | None = None  # of the last walk

    def walk(self, own: Turn, passing: Passing | None, sensor: SensorModel, shuffled: bool = False) -> Walk:
        """Begin a scan with copies of all that is known; ``own``, ``passing``: what it will tell the next one."""
        known = self._known
        order, counts = copied(known.order), copied(known.counts)
        self._tried = Known(order, counts, own, passing, known.rays, None, known.lists + 1)
        seen = seen_later(known.passing, passing, sensor)
        counted = no_counts(len(own.azimuth), known.turn, seen)
        self.passed = Passed(known.lists + 1, counted.there)
        return Walk(order, nothing_seen(), counts, counted, shuffled)

    def between(self, points: F64, laser: I64, origin: F64) -> NDArray[np.float32]:
        """Find the motion ``(6,)`` from the scan of rays before to points ``(N, 3)`` of lasers ``(N,)``, which a sensor at ``origin`` sees; zeros where there is none."""
        before = self._known.swept
        if before is None:
            return np.zeros(6, np.float32)
        guess = before.between.astype(np.float64)
        return find_between(before.points.astype(np.float64), points, laser, origin, guess).astype(np.float32)

    def turning(self, own: Swept, eyes: Eyes) -> RayWalk:
        """The same for a scan of points on the rays of ``eyes``."""
        known = self._known
        rays = new_ray_models() if known.rays is None else copied(known.rays)
        self._tried = Known(known.order, known.counts, no_turn(), None, rays, own, known.lists + 1)
        seen = no_rays(len(own.points), swept_later(known.swept, own, eyes))
        self.passed = Passed(known.lists + 1, seen.there)
        return RayWalk(rays, seen)

    def settle(self) -> None:
        """Keep what the last walk learned."""
        self._known = self._tried


class LearnedLists:
    """What was learned through a group, by numbers from 1 on; a writer's topics have theirs by and by."""

    def __init__(self) -> None:
        self._topics: dict[str, int] = {}
        self._of: dict[int, Learned] = {}

    def of_topic(self, topic: str) -> Learned | None:
        """Return what was learned of a topic; None where there are too many of them."""
        number = self._topics.setdefault(topic, len(self._topics) + 1)
        return self.of_number(number) if number <= MOST_LISTS else None

    def of_number(self, number: int) -> Learned:
        """Return what was learned of the list of this number."""
        if number not in self._of:
            self._of[number] = Learned(number)
        return self._of[number]

    def settle(self, number: int) -> None:
        """Keep what the last walk of this number learned."""
        self._of[number].settle()
