"""What a user asks for when asking for a map."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from salpcc.pipeline.mapping.map_export import FORMATS
from salpcc.stages.mapping.config import MapConfig


@dataclass(frozen=True)
class MapRequest:
    """What a user asks for: the map, and where and how it is made.

    ``poses`` as in :func:`salpcc.pipeline.mapping.map_plan.plan_map`; ``against`` is a data root with labels to
    score by, ``rivals`` are public cleaners to score beside; ``crs`` names the coordinate system of the poses; ``explain``
    writes what was removed and why; ``tune`` chooses how it is carved by movers pasted into the scans.
    """

    archives: list[Path]
    out: Path
    config: MapConfig = field(default_factory=lambda: MapConfig.model_validate({}))
    poses: list[str] = field(default_factory=list)
    formats: list[str] = field(default_factory=lambda: list(FORMATS))
    against: Path | None = None
    rivals: list[str] = field(default_factory=list)
    crs: str | None = None
    explain: bool = False
    tune: bool = False
    workers: int | None = None
    scheduler: str | None = None
    keep_shards: bool = False
    quiet: bool = False
    command: str = ""
