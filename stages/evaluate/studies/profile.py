"""Where the CPU time of a call goes: seconds by file of ours, what libraries take apart; the parts add up to the whole."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import salpcc.stages

LIBRARIES = "libraries"
_ROOT = Path(salpcc.stages.__file__).resolve().parent.parent


def profile(call: Callable[[], object]) -> Counter[str]:
    """Run ``call`` once and return CPU seconds by file.

    A compiled kernel counts to the file that calls it, for the profiler sees Python functions only; what Python does in
    a library counts to ``LIBRARIES``, what a library compiled does to the file that calls it.

    >>> seconds = profile(lambda: sum(range(1000)))
    >>> list(seconds)
    ['libraries']
    """
    profiler = cProfile.Profile(time.process_time)
    profiler.runcall(call)
    seconds: Counter[str] = Counter()
    for (file, _, _), (_, _, own, _, callers) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]
        if file == "~":  # of a built-in: who calls it pays
            for (caller, _, _), (_, _, part, _) in callers.items():
                seconds[_name(caller)] += part
            if not callers:
                seconds[LIBRARIES] += own
        else:
            seconds[_name(file)] += own
    return seconds


def _name(file: str) -> str:
    """The name of a file below the package, or that of all libraries."""
    path = Path(file)
    if path.is_absolute() and (path := path.resolve()).is_relative_to(_ROOT):
        return path.relative_to(_ROOT).with_suffix("").as_posix()
    return LIBRARIES
