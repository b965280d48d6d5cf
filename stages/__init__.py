"""The six reversible stages, in order: ingest, segment, ground_fit, predict, residual_code, evaluate.

Compiled kernels are kept per user, in a folder that is named by all sources of this package: numba looks at the file of a kernel only,
not at those of the functions that it takes in, and would go on with what they were before an update. ``NUMBA_CACHE_DIR`` overrides it.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path


def _kernels_folder() -> Path:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        facts = path.stat()
        digest.update(f"{path}\0{facts.st_size}\0{facts.st_mtime_ns}\n".encode())
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "salpcc-pipeline" / f"kernels-{digest.hexdigest()[:16]}"


def kernels_are_kept() -> bool:
    """Tell whether kernels were compiled before; if none was, the next run takes a minute longer."""
    return any(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbc"))


if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = str(_kernels_folder())  # read when numba is imported, by workers, too
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
