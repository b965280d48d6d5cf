"""An organised cloud of which a layer has some places: where values are told, where a reader has them, and where nothing is known."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lists.aimed.aimed_layers import GONE, OWN, scattered

_FAR = 200.0  # metres


class Grid(NamedTuple):
    """The places ``(W,)`` of an organised cloud, row by row.

    Attributes:
        width: of a row.
        void: whether there is no return; so where there is no point of the layers that are known.
        ranges: float64, distances in metres, 0 where void.
        role: uint8, OWN of the points that are coded, GIVEN of the static layer's where they are of the movable one, else GONE.
    """

    width: int
    void: NDArray[np.bool_]
    ranges: NDArray[np.float64]
    role: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        n: int,
        width: int,
        layers: list[tuple[int, NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]],
    ) -> Grid:
        """Put layers (role, places, void, ranges) into a cloud of ``n`` places."""
        grid = cls(width, np.ones(n, np.bool_), np.zeros(n), np.full(n, GONE, np.uint8))
        for role, places, void, ranges in layers:
            grid.role[places], grid.void[places], grid.ranges[places] = role, void, ranges
        return grid

    def lit(self) -> Grid:
        """Return it with void points that are points like others, far away."""
        void = self.role == GONE
        return self._replace(void=void, ranges=np.where(self.void & ~void, _FAR, self.ranges))

    def spread(self, values: NDArray[Any], given: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the values ``(W,)`` of all places: those of the layer ``(N,)``, those that are given ``(T,)``, else 0."""
        return scattered(self.role, values, given)

    def own(self, whole: NDArray[Any]) -> NDArray[Any]:
        """Return those of the layer ``(N,)``; inverse of :meth:`spread`."""
        return whole[self.role == OWN]
