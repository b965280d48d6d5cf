"""The archive of one sequence: an MCAP file, one message per scan, one chunk per GOP (schemas/ARCHIVE.md).

Here: what an archive holds. :mod:`.writer` and :mod:`.reader` are each other's inverse.
"""

from __future__ import annotations

import re
import struct
from dataclasses import astuple, dataclass, replace
from typing import Any

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.lattice.sensor_model import SensorModel

ARCHIVE_VERSION = "3.0"
MAGIC = b"\x89MCAP0\r\n"
DESCRIPTION, INDEX = "description", "index"  # the attachments that every archive has
GOP_OPCODE = 0x80  # of records that MCAP leaves to applications
GOP_HEAD = struct.Struct("<BQI")  # of such a record: opcode, length, CRC of the document behind
DIGITS = 16  # of the sensor model's digest
TOPIC = "/points/salpcc"
# What may have a channel of its own: its topic. The id is in the metadata, under the name and "_channel".
OWN_TOPICS = {
    "movable": "/points/salpcc/movable",
    "labels": "/points/salpcc/labels",
    "movable_labels": "/points/salpcc/movable/labels",
}
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
    labels: int = 0  # bytes beside the payload

    @property
    def bytes(self) -> int:
        """Bytes of the payload."""
        return self.geometry + self.intensity + self.classes + self.side

    def of_sizes(self, sizes: dict[str, Any]) -> ScanEntry:
        """Return it with the bytes by group of another payload of the same scan."""
        return replace(self, **sizes)

    def with_layer(self, movable: ScanEntry) -> ScanEntry:
        """Return the entry of both layers of a scan, this being that of the static one."""
        sums = {
            name: getattr(self, name) + getattr(movable, name)
            for name in ("kept", "strays", "geometry", "intensity", "classes", "side", "labels")
        }
        return replace(self, dropped_movable=self.dropped_movable - movable.kept, **sums)


@dataclass(frozen=True)
class ScanPayload:
    """One coded scan, or one layer of it: its entry, time stamp (ns), frame id, and the payload of the entropy coder.

    ``movable`` is the other layer of the scan where this is the static one, and both are to be written;
    ``labels`` are the coded labels of the points of this layer, empty where there are none.
    """

    entry: ScanEntry
    time: int
    frame_id: str
    data: bytes
    movable: ScanPayload | None = None
    labels: bytes = b""

    @property
    def checksum(self) -> str:
        """The CRC-32 that ends the payload, 8 hex digits."""
        return self.data[:-5:-1].hex()


@dataclass(frozen=True)
class ArchiveFacts:
    """What is the same for the whole archive.

    ``config`` is :attr:`salpcc.schemas.config.RunConfig.coding`; ``source`` the kind of source and
    ``inputs`` the digest of the source files and the configuration, by which a run knows it is done.
    ``layers``: the archive has a movable layer, or had one. ``labels``: it has a channel for labels.
    """

    sequence: str
    source: str
    inputs: str
    config: dict[str, Any]
    sensor: SensorModel
    layers: bool = False
    labels: bool = False

    @property
    def version(self) -> str:
        """Version of the archive."""
        return ARCHIVE_VERSION

    @property
    def channels(self) -> tuple[str, ...]:
        """What has a channel of its own, besides the scans."""
        asked = {"movable": self.layers, "labels": self.labels, "movable_labels": self.layers and self.labels}
        return tuple(name for name, there in asked.items() if there)


def check_version(version: str) -> None:
    """Refuse an archive of another major version; raises ArchiveError."""
    major, ours = int(version.split(".")[0]), int(ARCHIVE_VERSION.split(".")[0])
    if major > ours:
        raise ArchiveError(
            f"archive version {version} is newer than this tool reads ({ARCHIVE_VERSION}); update it"
        )
    if major < ours:
        raise ArchiveError(
            f"archive version {version} is older than this tool reads ({ARCHIVE_VERSION}); the release that wrote it reads it"
        )


def read_own_channels(about: dict[str, str]) -> dict[str, int]:
    """Read the ids of the channels that are an archive's own, by name, from its metadata."""
    return {name: int(about[f"{name}_channel"]) for name in OWN_TOPICS if f"{name}_channel" in about}


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


def row_of(entry: ScanEntry) -> list[Any]:
    """Return the row of the index; without labels it has no number for them."""
    row = list(astuple(entry))
    return row if entry.labels else row[:-1]


def entry_of(row: list[Any]) -> ScanEntry:
    """Read a row of the index, which nobody vouches for; inverse of :func:`row_of`."""
    name, *counts = row
    if not all(isinstance(n, int) and n >= 0 for n in counts):
        raise ValueError("a row of the index is not a name and counts")
    return ScanEntry(file_name(name), *counts)


def file_name(name: object) -> str:
    """Refuse a name that could lead out of the folder that a user decodes to."""
    if not isinstance(name, str) or name in ("", ".", "..") or re.search(r"[/\\\x00]", name):
        raise ValueError(f"{name!r} cannot name a file")
    return name
