"""The plan of a map: which groups of scans of which archives, and where they stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_poses import given_poses, several_topics
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.stages.residual_code.archive.format import frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader

F64 = NDArray[np.float64]
ODOMETRY = "odometry"
_FAR = 10_000.0  # metres


@dataclass(frozen=True)
class Group:
    """One GOP of an archive.

    Attributes:
        number: place in the map's order.
        names, numbers: of its scans; the numbers tell how many turns apart they are.
        poses: 16 numbers a scan, sensor to map; empty where odometry is to find them.
    """

    archive: str
    sequence: str
    gop: int
    number: int
    names: tuple[str, ...]
    numbers: tuple[int, ...]
    poses: tuple[float, ...] = ()

    def given(self) -> F64 | None:
        """Return the poses ``(n, 4, 4)``, or None."""
        return np.array(self.poses).reshape(-1, 4, 4) if self.poses else None


@dataclass(frozen=True)
class MapPlan:
    """The groups of a map in the order of the drive, and where its poses came from.

    Attributes:
        origin: of the map's frame, which the poses of the groups are in, in the frame of the poses that were given.
    """

    groups: tuple[Group, ...]
    poses: str
    sequence: str
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def n_scans(self) -> int:
        """Scans of all groups."""
        return sum(len(group.names) for group in self.groups)


def plan_map(archives: Sequence[Path], poses: Sequence[str]) -> MapPlan:
    """List the groups of archives that make one map.

    ``poses`` is one file or topic for each archive, as :func:`given_poses` takes them, all in one frame; none, or ``odometry``,
    leave it to odometry.

    Raises:
        UsageError: not one poses file for each archive.
        SourceError: archives of different sensors, or clouds of several sensors in one, a scan that is in two of them, poses that are missing.
        ArchiveError: an archive is damaged.
    """
    if not archives:
        raise UsageError("no archive: name at least one, such as out/archives/04.mcap")
    sources = list(poses) or [ODOMETRY]
    by_odometry = sources == [ODOMETRY]
    if not by_odometry and (ODOMETRY in sources or len(sources) != len(archives)):
        raise UsageError(
            f"--poses: {len(sources)} for {len(archives)} archives; name one file for each, all in one frame, "
            "or odometry once"
        )
    readers = [ArchiveReader(path) for path in archives]
    _one_sensor(readers)
    groups: list[Group] = []
    origin: F64 | None = None
    seen: dict[tuple[str, str], Path] = {}
    for at, reader in enumerate(readers):
        names = reader.names
        for name in names:
            other = seen.setdefault((reader.facts.sequence, name), reader.path)
            if other is not reader.path:
                raise SourceError(f"scan {name} is both in {other} and in {reader.path}; name one of them")
        if by_odometry and several_topics(reader):
            raise SourceError(
                f"{reader.path}: clouds of several topics, which are no one drive; take one with cut --topic "
                "(inspect lists them), or give --poses"
            )
        placed = None if by_odometry else given_poses(sources[at], reader)
        if placed is not None:
            origin = origin_of(placed) if origin is None else origin
            placed[:, :3, 3] -= origin
        first = 0
        for gop, entries in enumerate(reader.gops):
            if not entries:
                continue
            last = first + len(entries)
            groups.append(
                Group(
                    str(reader.path),
                    reader.facts.sequence,
                    gop,
                    len(groups),
                    tuple(names[first:last]),
                    tuple(frame_number(names[i], i) for i in range(first, last)),
                    () if placed is None else tuple(placed[first:last].ravel().tolist()),
                )
            )
            first = last
    if not groups:
        raise SourceError(f"{archives[0]}: no scan in it")
    sequences = dict.fromkeys(group.sequence for group in groups)
    x, y, z = (0.0, 0.0, 0.0) if origin is None else origin.tolist()
    return MapPlan(tuple(groups), ", ".join(sources), "+".join(sequences), (x, y, z))


def origin_of(poses: F64) -> F64:
    """Return where the frame of a map begins ``(3,)``: at the first of its poses ``(n, 4, 4)``, if that is far from zero.

    Coordinates of a country have millions of metres, of which float32 keeps half a metre and the key of a voxel too little.
    """
    first = poses[0, :3, 3] if len(poses) else np.zeros(3)
    return np.round(first, 3) if np.abs(first).max() > _FAR else np.zeros(3)


def _one_sensor(readers: list[ArchiveReader]) -> None:
    first = readers[0]
    for reader in readers[1:]:
        if reader.facts.sensor.digest != first.facts.sensor.digest:
            scan = next(iter(reader.names), "(none)")
            raise SourceError(
                f"{reader.path}: scan {scan} is of sensor {reader.facts.sensor.name}, the scans of {first.path} "
                f"are of {first.facts.sensor.name} (other calibration); map the archives of one sensor at a time"
            )
