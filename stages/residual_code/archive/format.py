"""The archive of one sequence: an MCAP file, one message per scan, one chunk per GOP (schemas/ARCHIVE.md).

Here: what an archive holds. ``archive_writer`` and ``archive_reader`` are each other's inverse.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

from salpcc.stages.lattice.sensor_model import SensorModel

ARCHIVE_VERSION = "1.1"  # of archives with one layer
LAYERED_VERSION = "2.0"  # of those with a movable layer, or of which it was taken out
MAGIC = b"\x89MCAP0\r\n"
TOPIC = "/points/salpcc"
MOVABLE_TOPIC = "/points/salpcc/movable"
MOVABLE_CHANNEL = "movable_channel"  # key of the metadata: id of its channel
LIBRARY = "salpcc-pipeline"  # without a version: the same scans give the same bytes from any release


@dataclass(frozen=True)
class ScanEntry:
    """What the index of an archive says about one scan, or one layer of it: counts of points, and bytes by stream."""

    name: str
    n_points: int
    kept: int
    dropped_movable: int
    strays: int
    geometry: int
    intensity: int
    classes: int
    side: int

    @property
    def bytes(self) -> int:
        """Bytes of the payload."""
        return self.geometry + self.intensity + self.classes + self.side

    def of_sizes(self, sizes: dict[str, int]) -> ScanEntry:
        """Return it with the bytes by group of another payload of the same scan."""
        counts = self.n_points, self.kept, self.dropped_movable, self.strays
        return ScanEntry(self.name, *counts, **sizes)

    def with_layer(self, movable: ScanEntry) -> ScanEntry:
        """Return the entry of both layers of a scan, this being that of the static one."""
        sums = {
            name: getattr(self, name) + getattr(movable, name)
            for name in ("kept", "strays", "geometry", "intensity", "classes", "side")
        }
        return replace(self, dropped_movable=self.dropped_movable - movable.kept, **sums)


@dataclass(frozen=True)
class ScanPayload:
    """One coded scan, or one layer of it: its entry, time stamp (ns), frame id, and the payload of the entropy coder.

    ``movable`` is the other layer of the scan where this is the static one, and both are to be written.
    """

    entry: ScanEntry
    time: int
    frame_id: str
    data: bytes
    movable: ScanPayload | None = None

    @property
    def checksum(self) -> str:
        """The CRC-32 that ends the payload, 8 hex digits."""
        return self.data[:-5:-1].hex()


@dataclass(frozen=True)
class ArchiveFacts:
    """What is the same for the whole archive.

    ``config`` is :attr:`salpcc.schemas.config.RunConfig.coding`; ``source`` the kind of source and
    ``inputs`` the digest of the source files and the configuration, by which a run knows it is done.
    ``layers``: the archive has a movable layer, or had one.
    """

    sequence: str
    source: str
    inputs: str
    config: dict[str, Any]
    sensor: SensorModel
    layers: bool = False

    @property
    def version(self) -> str:
        """Version of the archive."""
        return LAYERED_VERSION if self.layers else ARCHIVE_VERSION


def sequence_number(name: str, place: int) -> int:
    """The ``sequence`` of a scan's message: its name where that is a number, else ``place``, the messages before it."""
    return int(name) % 2**32 if name.isascii() and name.isdigit() else place


def frame_number(name: str, place: int) -> int:
    """The number by which users know a scan: its name where that is a number, also behind a topic; else its place.

    Args:
        place: the number of scans before it.
    """
    number = name.rpartition("-")[2]
    return int(number) if number.isascii() and number.isdigit() else place


def entry_of(row: list[Any]) -> ScanEntry:
    """Read a row of the index, which nobody vouches for."""
    name, *counts = row
    if not all(isinstance(n, int) and n >= 0 for n in counts):
        raise ValueError("a row of the index is not a name and counts")
    return ScanEntry(file_name(name), *counts)


def file_name(name: object) -> str:
    """Refuse a name that could lead out of the folder that a user decodes to."""
    if not isinstance(name, str) or name in ("", ".", "..") or re.search(r"[/\\\x00]", name):
        raise ValueError(f"{name!r} cannot name a file")
    return name
