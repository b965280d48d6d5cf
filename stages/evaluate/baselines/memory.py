"""Peak memory of a piece of work, above what the process held before it."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass
class Peak:
    """What :func:`peak_above` found; None until the work is done, and where the system does not tell."""

    megabytes: float | None = None


@contextmanager
def peak_above() -> Iterator[Peak]:
    """Measure the resident memory that the block takes at most beyond what is held when it begins.

    Linux only. Programs that the block runs are not counted.
    """
    peak = Peak()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # what was freed before must not hide what is taken now
    try:
        _RESET.write_text("5")
    except OSError:
        yield peak
        return
    before = _kilobytes("VmRSS")
    yield peak
    peak.megabytes = max(0, _kilobytes("VmHWM") - before) / 1024


def _kilobytes(key: str) -> int:
    found = re.search(rf"^{key}:\s+(\d+) kB", _STATUS.read_text(), re.MULTILINE)
    return int(found[1]) if found else 0
