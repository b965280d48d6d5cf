"""Run one function over many pieces of work, a bounded number at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from salpcc.schemas.errors import SalpccError


def each(
    client: Client, function: Callable[..., Any], work: Sequence[tuple[Any, ...]], what: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """Yield ``(index, function(*work[index]))`` as results come in; ``what`` names each piece in errors.

    Raises:
        SalpccError: the function's own; or workers keep dying of a piece; or the disk fails.
    """
    limit = 2 * (sum(client.nthreads().values()) or 1)
    running: dict[Future[Any], int] = {}
    done = as_completed()
    at = 0
    while at < len(work) or running:
        while at < len(work) and len(running) < limit:
            future = client.submit(function, *work[at], key=f"{what[at]}-{id(work):x}-{at}", pure=False)
            running[future] = at
            done.add(future)
            at += 1
        future = next(done)
        index = running.pop(future)
        try:
            result = future.result()
        except KilledWorker as error:
            raise SalpccError(
                f"{what[index]}: workers died {error.allowed_failures + 1} times on it (out of memory?); "
                "run the same command with fewer --workers"
            ) from error
        except OSError as error:
            raise SalpccError(f"{error}; make room or mend it, then run the same command again") from error
        yield index, result
