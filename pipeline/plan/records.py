"""The record of a sequence, beside its archive: what went in, what failed, and what the next run need not read again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from salpcc.schemas.files import atomic

RECORD_VERSION = 1


def record_path(out: Path, sequence: str) -> Path:
    """Where the record of a sequence lies: digests, errors and times of the run that made its archive."""
    return out / "records" / f"{sequence}.json"


def recorded(out: Path, sequence: str) -> dict[str, Any]:
    """Return the record of a sequence; empty where there is none that can be read."""
    try:
        record = json.loads(record_path(out, sequence).read_text())
    except (OSError, ValueError):
        return {}
    return dict(record) if record.get("version") == RECORD_VERSION else {}


def write_record(record: dict[str, Any], out: Path, sequence: str) -> None:
    """Write the record of a sequence."""
    with atomic(record_path(out, sequence)) as stream:
        stream.write(json.dumps({"version": RECORD_VERSION, **record}).encode())
