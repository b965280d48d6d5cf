"""What numba compiles is told apart from the work; the clock here is made up."""

import threading

import numpy as np
import pytest
from numba import njit
from numba.core import event

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
    with event.trigger_event("numba:compile"):
        clock.spend(*ms)
        with event.trigger_event("numba:compile"):
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
        if not few:  # a kernel that the first two scans did not need
            compile_for(clock, 3000, 4000)
        return "table"

    tasks._warm.discard("made up")
    assert tasks._timed("made up", run) == ("table", (40, 50))


def test_numba_tells_when_it_compiles() -> None:
    @njit
    def kernel(x):  # type: ignore[no-untyped-def]
        return x + 1

    with Stopwatch() as watch:
        assert kernel(1) == 2
    assert watch._compiling.min() > 0
