"""What ``map.json`` says of a map, and back: figures, frame, and the shards that :mod:`.map_edit` makes it again from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.pipeline.mapping.map_tiles import TileResult
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import write_json
from salpcc.schemas.work import ShardRef
from salpcc.stages.mapping.tiles import Tile

FILE = "map.json"


def write_summary(out: Path, summary: Mapping[str, Any]) -> None:
    """Write ``OUT/map.json``; inverse: :func:`read_summary`."""
    write_json(out / FILE, summary)


def read_summary(out: Path) -> dict[str, Any]:
    """Read what a map says of itself.

    Raises:
        UsageError: no map there.
    """
    try:
        summary = json.loads((out / FILE).read_text())
        assert isinstance(summary, dict) and "voxels" in summary
    except (OSError, ValueError, AssertionError) as error:
        raise UsageError(f"{out}: not the folder of a map (no {FILE} of one in it)") from error
    return summary


def figures_of_map(tiles: Sequence[TileResult]) -> dict[str, Any]:
    """Return what tiles add up to."""
    return {
        "points_in_map": sum(t.points for t in tiles),
        "voxels": {k: sum(getattr(t, k) for t in tiles) for k in ("kept", "carved", "dropped", "filled")},
        "tiles": [t.tile.name for t in tiles if t.kept],
    }


def frame_to_json(frame: Frame) -> dict[str, Any]:
    """Return what is said of a map's frame; inverse: :func:`frame_of_summary`."""
    return {"origin": list(frame.origin), "intensity_factor": frame.factor, "crs": frame.crs}


def frame_of_summary(summary: Mapping[str, Any]) -> Frame:
    """Return the frame of a map."""
    x, y, z = summary["origin"]
    return Frame((x, y, z), summary["intensity_factor"], summary["crs"])


def explained_to_json(tiles: Sequence[TileResult]) -> list[dict[str, Any]]:
    """Return the tiles of an explained map; inverse: :func:`explained_of_summary`."""
    return [asdict(tile) for tile in tiles if tile.ref is not None]


def explained_of_summary(summary: Mapping[str, Any]) -> list[TileResult]:
    """Return the tiles of an explained map."""
    return [
        TileResult(**{**row, "tile": Tile(**row["tile"]), "ref": ShardRef(**row["ref"])})
        for row in summary["explained"]
    ]
