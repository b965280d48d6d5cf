"""Time spent on work alone: what numba compiles, or loads, on the way is left out."""

from __future__ import annotations

import threading
import time
from typing import Any, Self

import numpy as np
from numba.core import event
from numpy.typing import NDArray

_UNDER_LOCK = "numba:compiler_lock"  # what numba calls it to compile a kernel, or to load one


class Stopwatch(event.Listener):  # type: ignore[misc]  # numba has no types
    """Measures the body of a ``with``: CPU and wall milliseconds of this thread, without what it does under numba's lock.

    A kernel that is first needed in the middle of a run would cost its first scans seconds to compile, or a hundredth to load.
    """

    def __enter__(self) -> Self:
        """Begin."""
        self._thread = threading.get_ident()
        self._depth = 0  # a kernel compiles those that it calls
        self._compiling: NDArray[np.float64] = np.zeros(2)
        event.register(_UNDER_LOCK, self)
        self._begun = _now()
        return self

    def __exit__(self, *_: object) -> None:
        """End; ``cpu_ms`` and ``wall_ms`` are there from now on."""
        self.cpu_ms, self.wall_ms = (_now() - self._begun - self._compiling).tolist()
        event.unregister(_UNDER_LOCK, self)

    def on_start(self, event: Any) -> None:
        """Compilation begins, in any thread."""
        if threading.get_ident() == self._thread:
            self._compiling -= _now() if self._depth == 0 else 0.0
            self._depth += 1

    def on_end(self, event: Any) -> None:
        """Compilation ends."""
        if threading.get_ident() == self._thread:
            self._depth -= 1
            self._compiling += _now() if self._depth == 0 else 0.0


def _now() -> NDArray[np.float64]:
    return 1e3 * np.array([time.thread_time(), time.perf_counter()])
