"""What encoder and decoder of a message's fields know of its points: how they lie, on the lattice of their sensor or in rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import Placed, aim, lies_on
from salpcc.stages.lattice.drivers import TURNING, measured
from salpcc.stages.lattice.layers import Layered, merged
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import sweep_to_scan
from salpcc.stages.lists.aimed.aimed_layers import GIVEN, OWN
from salpcc.stages.lists.timeline import LASERS, Passed, Timeline
from salpcc.stages.residual_code.message.blended_values import Around
from salpcc.stages.residual_code.message.firing_times import ON_LATTICE, Fired, fired_by
from salpcc.stages.residual_code.message.grid import Grid

# What lies around a point: those before it, those of its laser, those of its row and column; the same and a guide; its row and column, void points far away.
LISTED, FIRED, ROWS, GUIDED = range(4)
SKY = ROWS + GUIDED + 1
OF_ROWS = ROWS, ROWS + GUIDED, SKY
INTENSITY = "/intensity"  # no field of a message is called so
REFLECTIVITY = "reflectivity"
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_CLOSE = 0.002  # metres from the lattice


@dataclass(frozen=True)
class Points:
    """What encoder and decoder know of the points before their fields.

    Attributes:
        xyz: ``(N, 3)`` float32 as decoded.
        void: ``(N,)`` whether a point has no return: all zeros, or NaN.
        ranges: ``(N,)`` float64, distance from the sensor in metres, 0 where void.
        periods: distances at which fields may repeat.
        grid: the organised cloud that they are all, or a layer, of; None where it is none.
        sensor: whose lattice they may lie on.
        timeline: lasers and times of the points, where these are known.
        placed: which of them have known places on the lattice.
        guide: a column ``(N,)`` int64 that the field may follow from, where one is known.
        layered: the static layer, where the points are those of the movable one.
    """

    xyz: NDArray[np.float32]
    void: NDArray[np.bool_]
    ranges: NDArray[np.float64]
    periods: tuple[int, ...]
    grid: Grid | None = None
    sensor: SensorModel | None = None
    timeline: Timeline | None = None
    placed: Placed | None = None
    guide: NDArray[np.int64] | None = None
    layered: Layered | None = None

    @classmethod
    def of(
        cls,
        xyz: NDArray[np.float32],
        width: int,
        sensor: SensorModel | None = None,
        told: Timeline | Placed | None = None,
        layered: Layered | None = None,
        source: tuple[NDArray[np.int64], int] | None = None,
    ) -> Points:
        """Derive it from decoded points.

        Args:
            width: of a row of an organised cloud, else 0.
            told: timeline or places, by the points' own stream.
            source: places of a layer's points in it, and how many it has.
        """
        wide = xyz.astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            squares = (wide[:, 0] * wide[:, 0] + wide[:, 1] * wide[:, 1]) + wide[:, 2] * wide[:, 2]
            void = ~((squares > 0) & (squares < 1e12))
        ranges = np.sqrt(np.where(void, 0.0, squares))
        grid: Grid | None = None
        periods: tuple[int, ...] = (1, 16, 32, 64, 128)
        if width > 1 and source is None:
            periods = 1, width, 4 * width
            if len(xyz) % width == 0:
                grid = Grid(width, void, ranges, np.full(len(xyz), OWN, np.uint8))
        elif width > 1 and source is not None:
            layers = [(OWN, source[0], void, ranges)]
            static = None if layered is None else layered.static
            if static is not None and static.source is not None:
                beside = cls.of(static.stray_points[:, :3], 0)
                layers.append((GIVEN, static.source, beside.void, beside.ranges))
            grid = Grid.of(source[1], width, layers)
        timeline, placed = (told, None) if not isinstance(told, Placed) else (None, told)
        return cls(xyz, void, ranges, periods, grid, sensor, timeline, placed, layered=layered)

    @cached_property
    def fired(self) -> Fired | None:
        """Lasers and ticks of the points, of which none are known where lasers are told; None without a sensor."""
        if self.timeline is not None:
            laser = self.timeline.laser.astype(np.int64)
            return Fired(laser, np.zeros_like(laser), np.zeros(LASERS + 1, np.int64), 1)
        return None if self.sensor is None else fired_by(self.sensor, *self._aimed)

    @cached_property
    def _aimed(self) -> tuple[I64, I64, I64, F64]:
        assert self.sensor is not None
        return aim(self.sensor, self.xyz.astype(np.float64), placed=self.placed)

    @cached_property
    def counted(self) -> F64 | None:
        """Ranges ``(N,)`` in metres by the counts of points, distances of those without a place; None without a sensor."""
        if self.sensor is None:
            return None
        _, _, count, off = self._aimed
        return np.where(off < ON_LATTICE, count * self.sensor.count, self.ranges)

    @cached_property
    def measured(self) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Ranges and azimuths ``(N,)`` by the driver of the sensor, distance and 0 of points without a place; None where no such driver is known."""
        if self.sensor is None or self.sensor.driver is None or self.sensor.driver.formula not in TURNING:
            return None
        laser, tick, count, off = self._aimed
        on = off < ON_LATTICE
        found = measured(self.sensor.driver, self.sensor.count, laser[on], tick[on], count[on])
        both = self.ranges.astype(np.float32), np.zeros(len(on), np.float32)
        for values, told in zip(both, found, strict=True):
            values[on] = told
        return both

    @cached_property
    def whole(self) -> Points:
        """The points of both layers, in file order."""
        assert self.layered is not None and self.layered.static.cloud is not None and self.sensor is not None
        static, movable = self.layered
        return Points.of(merged(movable, sweep_to_scan(static, self.sensor).points, self.xyz), 0, self.sensor)

    def beside(self, name: str) -> NDArray[Any] | None:
        """The field of this name ``(T,)`` of the static layer, where there is one and the points' own stream tells no times."""
        cloud = None if self.layered is None else self.layered.static.cloud
        if self.layered is None or cloud is None or self.timeline is not None:
            return None
        if name == INTENSITY:
            return None if self.grid is None else self.layered.static.stray_points[:, 3]
        field = next((column for column in cloud.layout.columns if column.name == name), None)
        return None if field is None else cloud.values(field)

    def of_rows(self, values: NDArray[Any]) -> bool:
        """Whether values ``(N,)`` are of an organised cloud, and wide enough to follow from its columns."""
        return values.dtype.itemsize >= 2 and self.grid is not None

    def around(self, what: int) -> Around | None:
        """What values are blended from; None where it is not known."""
        n, nobody, guide = len(self.void), np.full(2, -1), np.zeros(0, np.int64)
        if what >= GUIDED and what != SKY:
            if self.guide is None:
                return None
            what, guide = what - GUIDED, self.guide
        if what in (ROWS, SKY):
            if self.grid is None:
                return None
            grid = self.grid.lit() if what == SKY else self.grid
            if len(guide):
                given = self.beside(REFLECTIVITY)
                guide = grid.spread(guide, None if given is None else given.astype(np.int64))
            lasers = np.zeros(1, np.int64)
            return grid.void, grid.ranges, grid.width, lasers, nobody, nobody, guide, grid.role
        own = np.full(n, OWN, np.uint8)
        if what == LISTED:
            return self.void, self.ranges, 0, np.zeros(n, np.int64), nobody, nobody, guide, own
        if self.fired is None:
            return None
        above, below = np.full(self.fired.lasers + 1, -1), np.full(self.fired.lasers + 1, -1)
        if self.sensor is not None:
            order = np.argsort(-self.sensor.theta, kind="stable")[: self.fired.lasers]
            above[order[1:]], below[order[:-1]] = order[:-1], order[1:]
        return self.void, self.ranges, 0, self.fired.laser, above, below, guide, own

    def ticks(self, what: int) -> tuple[NDArray[np.int64] | None, int]:
        """Ticks ``(N,)`` of points, and those in a turn, where what lies around is of lasers that tell them; else None."""
        if what % GUIDED != FIRED or self.timeline is not None or self.fired is None:
            return None, 0
        return self.fired.tick, self.fired.ticks

    @property
    def passed(self) -> Passed | None:
        """Where the points were in the cloud before, if their own stream tells."""
        return None if self.timeline is None else self.timeline.passed

    @cached_property
    def on_lattice(self) -> bool:
        """Whether lasers and ticks mean anything; to be asked by a writer only."""
        return self.timeline is not None or (
            self.sensor is not None and lies_on(self.sensor, self.xyz, _CLOSE)
        )
