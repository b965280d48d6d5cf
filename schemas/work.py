"""The work list: what a task is told. Small, frozen, hashable; only these travel between machines."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Literal

Known = dict[
    str, tuple[str, str]
]  # by name of a file its mark (schemas.marks), and the digest that it then had
Movable = Literal["layered", "dropped", "one layer"]  # what an archive did with what may move
STAGES = ("ingest", "segment", "ground_fit", "predict", "residual_code", "evaluate")


@dataclass(frozen=True)
class ScanRef:
    """Where one recorded scan lies.

    Attributes:
        name: stem of the file, e.g. ``000123``.
        number: frame number; scans of a sequence ascend in it, gaps are allowed.
        path: the points.
        time: nanoseconds since the start of the log.
        labels: the ``.label`` file, or None where there is none.
        columns: float32 numbers a point, of a file.
        topic, at: of a message in a log: its topic, and its place as the log tells it.
        digest, labels_digest: of the bytes of path and labels, where they are known; messages share their log's.
    """

    name: str
    number: int
    path: str
    time: int
    labels: str | None = None
    columns: int = 4
    topic: str = ""
    at: tuple[int, ...] = ()
    digest: str = ""
    labels_digest: str = ""


@dataclass(frozen=True)
class GopSource:
    """One group of pictures as it lies in its source: the unit of work.

    Attributes:
        source: key of :data:`salpcc.stages.ingest.sources.SOURCES`.
        sequence: name of the sequence.
        number: 0 for the first GOP of the run's selection of the sequence.
        scans: at most ``config.gop`` scans, ascending in number.
    """

    source: str
    sequence: str
    number: int
    scans: tuple[ScanRef, ...]


@dataclass(frozen=True)
class SideRef:
    """A file that lies with the scans of a sequence: its path in their folder, where it lies, and its SHA-256 if known."""

    name: str
    path: str
    digest: str = ""


@dataclass(frozen=True)
class ScanError:
    """A scan that failed: it travels with its GOP to the report; the others go on."""

    sequence: str
    scan: str
    stage: str
    reason: str


@dataclass(frozen=True)
class ShardRef:
    """A written shard: its file below ``OUT/shards`` and the digest of all that went into it."""

    path: str
    digest: str


def digest_of(*parts: object) -> str:
    """SHA-256 (hex) of the canonical JSON of ``parts``."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()
