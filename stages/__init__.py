"""The six reversible stages, in order: ingest, segment, ground_fit, predict, residual_code, evaluate.

Compiled kernels are kept per user, in a folder that is named by all sources of this package: numba looks at the file of a kernel only,
not at those of the functions that it takes in, and would go on with what they were before an update. ``NUMBA_CACHE_DIR`` overrides it.
A user without a home to write in, as in containers and services, has it among the temporary files.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path


def _kernels_folder() -> Path:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        facts = path.stat()
        digest.update(f"{path}\0{facts.st_size}\0{facts.st_mtime_ns}\n".encode())
    return _caches() / f"kernels-{digest.hexdigest()[:16]}"


def _caches() -> Path:
    """A folder that this user can write in, and nobody else: kernels are code."""
    kept = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "salpcc-pipeline"
    if kept.is_absolute():  # an unknown user's home stays ~
        with suppress(OSError):
            kept.mkdir(parents=True, exist_ok=True)
        if os.access(kept, os.W_OK | os.X_OK):
            return kept
    user = os.getuid() if hasattr(os, "getuid") else 0
    own = Path(tempfile.gettempdir()) / f"salpcc-pipeline-{user}"
    with suppress(OSError):
        own.mkdir(mode=0o700)
    with suppress(OSError):
        facts = own.lstat()
        if facts.st_uid == user and stat.S_ISDIR(facts.st_mode) and not facts.st_mode & 0o022:
            return own
    return Path(tempfile.mkdtemp(prefix="salpcc-pipeline-"))


def kernels_are_kept() -> bool:
    """Tell whether kernels were compiled before; if none was, the next run takes a minute longer."""
    return any(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbc"))


if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = str(_kernels_folder())  # read when numba is imported, by workers, too
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
