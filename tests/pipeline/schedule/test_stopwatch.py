"""What numba compiles is told apart from the work; the clock here is made up."""

import importlib
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from numba.core.compiler_lock import global_compiler_lock

from salpcc.pipeline.graph import tasks
from salpcc.pipeline.schedule import stopwatch
from salpcc.pipeline.schedule.stopwatch import Stopwatch


class Clock:
    def __init__(self) -> None:
        self.ms = np.zeros(2)

    def spend(self, cpu: float, wall: float) -> None:
        self.ms = self.ms + (cpu, wall)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(stopwatch, "_now", lambda: made.ms)
    return made


def compile_for(clock: Clock, *ms: float) -> None:
    """Compile a kernel, and one that it calls."""
    with global_compiler_lock:
        clock.spend(*ms)
        with global_compiler_lock:
            clock.spend(*ms)


def test_compilation_is_left_out(clock: Clock) -> None:
    with Stopwatch() as watch:
        clock.spend(5, 6)
        compile_for(clock, 1000, 2000)
        clock.spend(7, 8)
        compile_for(clock, 10, 20)
        other = threading.Thread(target=compile_for, args=(clock, 100, 100))  # is of no concern to this one
        other.start()
        other.join()
    assert (watch.cpu_ms, watch.wall_ms) == (212, 214)
    compile_for(clock, 10, 20)  # nobody listens any more


def test_stages_are_timed_so(clock: Clock) -> None:
    def run(few: bool) -> str:
        clock.spend(*((1, 1) if few else (40, 50)))
        if not few:  # a kernel that the first scan did not need
            compile_for(clock, 3000, 4000)
        return "table"

    tasks._warm.discard("made up")
    assert tasks._timed("made up", run) == ("table", (40, 50))


def test_numba_tells_when_it_compiles_and_when_it_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "made_up_kernel.py"
    module.write_text("from numba import njit\n\n\n@njit(cache=True)\ndef kernel(x):\n    return x + 1\n")
    for loaded in (0, 1):
        monkeypatch.delitem(sys.modules, module.stem, raising=False)
        monkeypatch.syspath_prepend(tmp_path)
        kernel = importlib.import_module(module.stem).kernel
        with Stopwatch() as watch:
            assert kernel(1) == 2
        assert sum(kernel.stats.cache_hits.values()) == loaded
        assert watch._compiling.min() > 0
