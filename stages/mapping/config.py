"""What a map is asked to be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

from salpcc.schemas.work import digest_of
from salpcc.stages.mapping.tiles import Box

# x0, y0, z0, x1, y1, z1
Corners = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class Carving(BaseModel):
    """How sure one must be that a place was empty."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    views: int = Field(2, ge=1, description="that must look through it")
    per_meeting: float = Field(2.0, gt=0, description="views that look through it for each that ends there")
    margin: float = Field(0.3, gt=0, description="metres by which a view must see beyond it")


class MapConfig(BaseModel):
    """Everything that decides what a map holds; nothing of where or how fast it is made. Lengths in metres."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    voxel: float = Field(0.1, ge=0.01, le=10)
    min_range: float = Field(2.0, ge=0, description="nearer points are the own car")
    max_range: float = Field(80.0, gt=0, le=500)
    labels: Literal["given", "network"] = Field(
        "given", description="who says what is movable where an archive does not"
    )
    layers: Literal["static", "all"] = Field(
        "static", description="what is read of an archive that has what may move in a layer of its own"
    )
    refine_poses: bool = Field(True, description="refine given poses where scans fit one another better so")
    keep_movable: bool = Field(False, description="keep what the classes call movable")
    carve: bool = Field(True, description="take out what several scans look through")
    carving: Carving = Field(
        Carving.model_validate({}), description="what it takes to be carved; tuned where asked"
    )
    fill: bool = Field(False, description="close small holes in the ground, as class SYNTHETIC")
    tile: float = Field(50.0, ge=5, le=1000, description="side of a tile")
    within: Corners | None = Field(
        None, description="x0, y0, z0, x1, y1, z1 in the frame of the poses: the part of the map that is made"
    )
    view_every: float = Field(1.5, gt=0, description="way between the scans that carve")

    @field_validator("within")
    @classmethod
    def _ordered(cls, box: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if box is not None and not all(low < high for low, high in zip(box, box[3:], strict=False)):
            raise ValueError("six numbers x0,y0,z0,x1,y1,z1, the first three the lower ones")
        return box

    def box(self, origin: Sequence[float]) -> Box | None:
        """Return ``within`` in the frame of a map with this ``origin`` ``(3,)``; None where the whole is made."""
        return None if self.within is None else Box.of(self.within).moved([-value for value in origin])

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of all fields."""
        return digest_of(self.model_dump(mode="json"))
