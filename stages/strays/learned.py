"""What efforts above ``fast`` learn of the lists of points of a group, topic by topic, and take along from scan to scan."""

from __future__ import annotations

from typing import NamedTuple

from salpcc.stages.entropy.mixed_numbers import copied
from salpcc.stages.strays.learned_counts import (
    CountModels,
    CountSeen,
    Turn,
    new_count_models,
    no_counts,
    no_turn,
)
from salpcc.stages.strays.learned_order import OrderModels, OrderSeen, new_order_models, nothing_seen

MOST_LISTS = 15  # topics of a group that learn; the others are coded as ``fast`` does


class Known(NamedTuple):
    """Models, which adapt, and the sweep before."""

    order: OrderModels
    counts: CountModels
    turn: Turn


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
        self._known = Known(new_order_models(), new_count_models(), no_turn())
        self._tried = self._known

    def walk(self, own: Turn) -> Walk:
        """Begin a scan with copies of all that is known; ``own``: what it will tell the next one."""
        order, counts = copied(self._known.order), copied(self._known.counts)
        self._tried = Known(order, counts, own)
        return Walk(order, nothing_seen(), counts, no_counts(len(own.azimuth), self._known.turn))

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
