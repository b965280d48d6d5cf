"""Work on a cluster: pieces are begun as they were queued, a bounded number at a time, and come back as they are done.

Runs, maps and localisation go through this one loop. Everything a task needs to know fits in a few hundred bytes; data move
through the shard store, where a task that was done before finds its result.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from math import inf
from typing import Any, Generic, TypeVar

from distributed import Client, Future, as_completed
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from salpcc.pipeline.schedule.progress import Report
from salpcc.schemas.errors import SalpccError, WorkersDiedError
from salpcc.schemas.files import unreachable, why

_COUNT_EVERY = 5.0  # seconds between looks at how many workers there are
T = TypeVar("T")


class Flow(Generic[T]):
    """Pieces of work, each with a tag that comes back with its result; more may be queued meanwhile.

    ``waiting`` holds how each piece is begun and its tag, the next one first.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self.waiting: deque[tuple[Callable[[], Future[Any]], T]] = deque()
        self._limit, self._counted = 0, -inf

    def submit(self, name: str, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a task, whose arguments may be futures of others; ``name`` is its own in this flow."""
        return self._client.submit(function, *arguments, key=f"{name}-{id(self):x}", pure=False)

    def __iter__(self) -> Iterator[tuple[T, Future[Any]]]:
        """Yield tags and futures as pieces are done, until none waits.

        Raises:
            SalpccError: the scheduler is gone.
        """
        running: dict[Future[Any], T] = {}
        done = as_completed()
        with _scheduler():
            while self.waiting or running:
                while self.waiting and len(running) < self._room():
                    begin, tag = self.waiting.popleft()
                    future = begin()
                    running[future] = tag
                    done.add(future)
                future = next(done)
                yield running.pop(future), future

    def _room(self) -> int:
        """How many pieces may be on their way: one a thread in work, one waiting. Workers come and go."""
        if time.monotonic() > self._counted + _COUNT_EVERY:
            self._limit = 2 * (sum(self._client.nthreads().values()) or 1)
            self._counted = time.monotonic()
        return self._limit


def each(
    client: Client,
    function: Callable[..., Any],
    work: Sequence[tuple[Any, ...]],
    what: Sequence[str],
    report: Report | None = None,
    steps: Sequence[tuple[int, str]] = (),
) -> list[Any]:
    """Return ``function(*arguments)`` of all pieces of work, in their order.

    Args:
        what: names each piece in errors.
        report, steps: who is told, when each piece is done, what :meth:`.Report.advance` takes of it.

    Raises:
        SalpccError: as :func:`value_of`; or the scheduler is gone.
    """
    flow: Flow[int] = Flow(client)
    for at, arguments in enumerate(work):
        flow.waiting.append((partial(flow.submit, f"{what[at]}-{at}", function, *arguments), at))
    results: dict[int, Any] = {}
    for at, future in flow:
        results[at] = value_of(future, what[at])
        if report is not None:
            report.advance(*steps[at])
    return [results[at] for at in range(len(work))]


def value_of(future: Future[Any], what: str) -> Any:
    """Return the result of a task; ``what`` names it in errors.

    Raises:
        SalpccError: the task's own; or the disk fails, or the scheduler is gone.
        WorkersDiedError: workers keep dying of it.
    """
    try:
        with _scheduler():
            return future.result()
    except KilledWorker as error:
        raise WorkersDiedError(what, error.allowed_failures + 1) from error
    except SalpccError:
        raise
    except Exception as error:
        if not (isinstance(error, OSError) or unreachable(error)):
            raise
        name = getattr(error, "filename", None)
        said = f"{name}: {why(error)}" if name else why(error)
        raise SalpccError(f"{said}; make room or mend it, then run the same command again") from error


@contextmanager
def _scheduler() -> Iterator[None]:
    try:
        yield
    except (CancelledError, CommClosedError) as error:
        raise SalpccError(
            "the scheduler is gone; start it and its workers again, then run the same command again"
        ) from error
