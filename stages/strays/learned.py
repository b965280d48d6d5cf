"""What efforts above ``fast`` learn of the lists of points of a group, topic by topic, and take along from scan to scan."""

from __future__ import annotations

from typing import NamedTuple

from salpcc.stages.entropy.mixed_numbers import copied
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.strays.learned_counts import (
    CountModels,
    CountSeen,
    new_count_models,
    no_counts,
)
from salpcc.stages.strays.learned_order import OrderModels, OrderSeen, new_order_models, nothing_seen
from salpcc.stages.strays.moved_sweep import Passing, Turn, no_turn, seen_later
from salpcc.stages.strays.timeline import Passed

MOST_LISTS = 15  # topics of a group that learn; the others are coded as ``fast`` does


class Known(NamedTuple):
    """Models, which adapt, and the sweep before; ``passing``: of a sensor whose motion is known; how many lists there were."""

    order: OrderModels
    counts: CountModels
    turn: Turn
    passing: Passing | None
    lists: int


class Walk(NamedTuple):
    """What :func:`.aimed_coder.code_aimed` takes: models, and what the scan shows."""

    order: OrderModels
    heard: OrderSeen
    counts: CountModels
    counted: CountSeen


class Learned:
    """What was learned of the clouds of one topic; a writer tries things, so what it learned counts only once it is :meth:`settled`."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._known = Known(new_order_models(), new_count_models(), no_turn(), None, 0)
        self._tried = self._known
        self.passed: Passed | None = None  # of the last walk

    def walk(self, own: Turn, passing: Passing | None, sensor: SensorModel) -> Walk:
        """Begin a scan with copies of all that is known; ``own``, ``passing``: what it will tell the next one."""
        known = self._known
        order, counts = copied(known.order), copied(known.counts)
        self._tried = Known(order, counts, own, passing, known.lists + 1)
        seen = seen_later(known.passing, passing, sensor)
        counted = no_counts(len(own.azimuth), known.turn, seen)
        self.passed = Passed(known.lists + 1, counted.there)
        return Walk(order, nothing_seen(), counts, counted)

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
