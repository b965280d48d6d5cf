"""What this process may use of its machine, and what it has used."""

from __future__ import annotations

import os
import sys


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def allowed_mb() -> float:
    """Largest address space that this process may take, MB, as ``ulimit -v`` says; infinite where nothing is said."""
    try:
        import resource
    except ModuleNotFoundError:
        return float("inf")
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if most == resource.RLIM_INFINITY else most / (1 << 20)


def peak_mb() -> float:
    """Largest memory of this process so far, MB; 0 where the system does not tell (Windows)."""
    try:
        import resource
    except ModuleNotFoundError:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)
