"""The one loop of runs, maps and localisation: bounded, and what goes wrong on the way is one line."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.flow import Flow, each, value_of
from salpcc.pipeline.schedule.progress import Silent
from salpcc.schemas.errors import SalpccError, WorkersDiedError


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with connect(0, None) as client:
        yield client


def test_pieces_come_back_in_their_order(client: Client) -> None:
    work = [(n, 10) for n in range(9)]
    told: list[int] = []

    class Told(Silent):
        def advance(self, scans: int, doing: str) -> None:
            told.append(scans)

    steps = [(n, "counted") for n in range(9)]
    assert each(client, pow, work, list("abcdefghi"), Told(), steps) == [n**10 for n in range(9)]
    assert sorted(told) == list(range(9))


def test_pieces_begin_as_queued_and_more_may_be_queued_first(client: Client) -> None:
    flow: Flow[str] = Flow(client)
    begun: list[str] = []

    def piece(name: str) -> tuple[Callable[[], Any], str]:
        def begin() -> Any:
            begun.append(name)
            return flow.submit(name, str.upper, name)

        return begin, name

    flow.waiting.extend(map(piece, "abcdef"))
    came = []
    for tag, future in flow:
        came.append(value_of(future, tag))
        assert len(begun) <= len(came) + 2  # one in work on the one thread, one that waits
        if tag == "a":
            flow.waiting.appendleft(piece("z"))
    assert sorted(came) == sorted("ABCDEFZ")
    assert begun.index("z") < begun.index("d") and begun[:2] == ["a", "b"]


def _full(_: int) -> None:
    raise OSError(28, "No space left on device", "/there/shard.arrow")


def _wrong(_: int) -> None:
    raise SalpccError("that scan: so it is")


def _broken(_: int) -> None:
    raise ZeroDivisionError("a fault of ours")


@pytest.mark.parametrize(
    ("task", "error", "said"),
    [
        (_full, SalpccError, "/there/shard.arrow: No space left on device; make room or mend it"),
        (_wrong, SalpccError, "^that scan: so it is$"),
        (_broken, ZeroDivisionError, "a fault of ours"),
    ],
)
def test_what_a_task_raises_is_said(
    client: Client, task: Callable[[int], None], error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        each(client, task, [(1,)], ["piece"])


def test_a_scheduler_that_is_gone_is_said(client: Client) -> None:
    class Gone:
        def result(self) -> None:
            raise CancelledError

    with pytest.raises(SalpccError, match="the scheduler is gone; start it"):
        value_of(Gone(), "tile")  # type: ignore[arg-type]


def _die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_what_workers_keep_dying_of_is_named(tmp_path: Path) -> None:
    import dask

    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), connect(1, None) as client:
        with pytest.raises(
            WorkersDiedError, match=r"^tile 3: workers died 1 times on it .* fewer --workers$"
        ) as info:
            each(client, _die, [(1,)], ["tile 3"])
        assert info.value.reason == "workers died 1 times on it (out of memory?)"
