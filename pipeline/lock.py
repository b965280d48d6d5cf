"""One run per output folder. The lock dies with the process, however it dies."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from salpcc.schemas.errors import LockedError, UsageError


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the output folder, which is made where it is missing.

    Raises:
        LockedError: another run holds it.
        UsageError: it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        handle = open(out / ".lock", "a+")  # noqa: SIM115 (closed below; a lock lives as long as its file)
    except OSError as error:
        raise UsageError(f"{out}: cannot write there ({error.strerror})") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            handle.seek(0)
            holder = handle.read().strip() or "unknown"
            raise LockedError(
                f"{out}: another run (process {holder}) is using this output folder; wait for it or choose --out"
            ) from error
        handle.truncate(0)
        handle.write(str(os.getpid()))
        handle.flush()
        yield
