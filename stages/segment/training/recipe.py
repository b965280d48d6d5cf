"""How the network is trained: the recipe that the shipped weights come from, in three phases."""

from __future__ import annotations

from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class SampleConfig:
    """How crops are made.

    Attributes:
        width: columns of a crop.
        mixed, pasted: share of crops that are mixed with another, or get instances pasted.
        most_pasted: instances pasted into one crop at most.
        kinds: how often a truck or another vehicle, a person, and any other class but cars is pasted per car.
        from_donors: share of the pasted instances that comes from donor scans, where there are any.
        distorted: whether crops are turned, scaled, mirrored and thinned out.
        turned: share of the distorted crops that are turned any way at all, not just along the road.
        brightened: share of the distorted crops that get another sensor's intensities.
        other_sensors: share of the distorted crops that get another sensor's rings, or no intensities.
        unlabelled: share of the crops from where nobody has labelled, of which only teachers know anything.
    """

    width: int = 512
    mixed: float = 0.25
    pasted: float = 0.35
    most_pasted: int = 3
    kinds: tuple[float, float, float] = (0.35, 0.15, 0.1)
    from_donors: float = 0.4
    distorted: bool = True
    turned: float = 0.4
    brightened: float = 0.25
    other_sensors: float = 0.0
    unlabelled: float = 0.0


@dataclass(frozen=True)
class Phase:
    """A part of the training.

    Attributes:
        until: share of the steps at which it ends.
        samples: how crops are made.
        root: classes weigh in the loss by this root of their inverse share.
        movable: weight of the group movable in the cross-entropy over the groups.
        dropped: share of the channels left out below the first level.
    """

    until: float = 1.0
    samples: SampleConfig = field(default_factory=SampleConfig)
    root: float = 4.0
    movable: float = 1.0
    dropped: float = 0.1


# Rare classes first, then streets as they are: with square roots to the end every trunk was a person.
PHASES = (
    Phase(
        0.35,
        SampleConfig(512, 0.35, 0.7, 6, (0.6, 0.5, 0.3), 0.0, turned=0.0, brightened=0.0),
        root=2.0,
        movable=2.0,
        dropped=0.0,
    ),
    Phase(0.6, SampleConfig(512, 0.35, 0.7, 6, (0.5, 0.25, 0.15), turned=0.0, brightened=0.0), dropped=0.0),
    Phase(),
)
# Of weights that know streets already: with more of what is rare set into them, then streets as they are.
GOING_ON = (Phase(0.7, SampleConfig(512, 0.3, 0.7, 5, (0.5, 0.6, 0.6), 0.3)), Phase())
_OTHER_SENSORS = 0.5  # of the crops, where weights are for any sensor
_UNLABELLED = 0.15  # of the crops, once teachers know something


def for_any_sensor(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """Return phases whose crops are those of other sensors, too."""
    return tuple(
        replace(phase, samples=replace(phase.samples, other_sensors=_OTHER_SENSORS)) for phase in phases
    )


def with_teachers(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """Return phases of which all but the first also show what nobody has labelled."""
    first, *others = phases
    return first, *(
        replace(phase, samples=replace(phase.samples, unlabelled=_UNLABELLED)) for phase in others
    )


@dataclass(frozen=True)
class Recipe:
    """How the network is trained.

    Attributes:
        width: key of :data:`~salpcc.stages.segment.network.multimodal.WIDTHS`.
        teachers: networks of twice the width that learn beside it, and tell it what they see in every crop.
        steps, batch: optimiser steps, crops in each.
        rate: peak learning rate. The paper trains at 5e-4 for 40,000 epochs; for thousands of steps more is better.
        betas: of Adam, the paper's.
        decay: weight decay (AdamW).
        seed: of the weights and the crops.
        workers: processes that make crops.
        every: steps between checkpoints, scores and lines of the log.
        phases: what changes on the way, in order; the last one ends at 1.
        start: weights to go on from, a name or a file; empty: none.
        learned: how far from ``start`` to what is learned the weights end, as a share of the way.
    """

    width: str = "small"
    teachers: int = 0
    steps: int = 2000
    batch: int = 16
    rate: float = 2.5e-3
    betas: tuple[float, float] = (0.9, 0.99)
    decay: float = 0.01
    seed: int = 0
    workers: int = 1
    every: int = 250
    phases: tuple[Phase, ...] = PHASES
    start: str = ""
    learned: float = 0.5

    def phase(self, step: int) -> Phase:
        """Return what holds at a step, counted from 0."""
        return next((p for p in self.phases if step < p.until * self.steps), self.phases[-1])
