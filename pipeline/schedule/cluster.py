"""Where tasks run: a local cluster of one-thread processes, or any Dask cluster by its address."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import dask
from distributed import Client, LocalCluster, Nanny, Worker
from distributed.core import Status
from tornado.ioloop import PeriodicCallback

from salpcc.pipeline.schedule.fork_server import ENVIRONMENT, METHOD, start_fork_server
from salpcc.pipeline.schedule.machine import cores
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import why
from salpcc.schemas.version import TOOL
from salpcc.stages.memory import keep_memory

_LOOK_EVERY = 1000.0  # milliseconds


class _Nanny(Nanny):
    """Keeps a worker that draws no pages of its own: nobody looks at them, and to import what draws them takes it a second.

    Its environment is that of this process; the one that it is forked from may have an older one.
    """

    def __init__(self, *addresses: Any, **options: Any) -> None:
        super().__init__(*addresses, **options | {"dashboard": False, "env": dict(os.environ)})


@contextmanager
def connect(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """Yield a Dask client.

    Args:
        workers: number of local processes; None is one per core, 0 runs in this very process.
        scheduler: address of a running scheduler, used instead of a local cluster.

    Raises:
        UsageError: the scheduler does not answer, or its workers run another version of this tool.
    """
    # What fails comes back as the exception of a task; Dask would print its traceback besides.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(
                f"--scheduler {scheduler}: no answer; start one with `dask scheduler`"
            ) from error
        with client:
            _same_tool(client, scheduler)
            yield client
        return
    count = workers if workers is not None else cores()
    settings: dict[str, object] = {
        "distributed.worker.daemon": True,
        "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
        "distributed.worker.multiprocessing-method": METHOD,
        "distributed.admin.tick.limit": "60s",
        "distributed.scheduler.worker-saturation": 1.0,
        # In this very process the scheduler has no address of its own, and Dask would name that of the machine.
        "distributed.dashboard.link": "{scheme}://127.0.0.1:{port}/status",
        # Nobody looks at it, and up to Python 3.11 it can lock up with a thread that begins (gh-106883).
        "distributed.worker.profile.enabled": False,
    }
    if count:
        settings["distributed.worker.preload"] = [__name__]
    with (
        dask.config.set(settings),
        _local_cluster(count) as cluster,
        Client(cluster) as client,
        _kept_at(count, cluster),
    ):
        yield client


def _local_cluster(count: int) -> LocalCluster:
    """Start the processes; raises UsageError where the machine has none to give, as without shared memory for their locks."""
    try:
        start_fork_server(count, None)
        return LocalCluster(
            n_workers=max(count, 1),
            threads_per_worker=1,
            processes=count > 0,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            worker_class=_Nanny if count else None,
            silence_logs=logging.CRITICAL,
        )
    except (OSError, RuntimeError) as error:
        reason: BaseException | None = error
        while reason is not None and not isinstance(reason, OSError):
            reason = reason.__cause__ or reason.__context__
        if not count or reason is None:
            raise
        raise UsageError(
            f"no process can be started for a worker ({why(reason)}; is /dev/shm writable?); --workers 0 goes without"
        ) from error


@contextmanager
def _kept_at(count: int, cluster: LocalCluster) -> Iterator[None]:
    """Start workers anew that Dask gives up: one that died and is not back within 15 s, as on a busy machine."""
    loop = cluster.loop
    if not count or loop is None:
        yield
        return
    callback = PeriodicCallback(partial(_refill, count, cluster), _LOOK_EVERY)
    loop.add_callback(callback.start)
    try:
        yield
    finally:
        loop.add_callback(callback.stop)


def _refill(count: int, cluster: LocalCluster) -> None:
    for name, nanny in list(cluster.workers.items()):
        if nanny.status in (Status.closed, Status.failed):
            del cluster.workers[name]
    cluster.scale(count)


def dask_setup(_: Worker) -> None:
    """Leave Ctrl-C to the run, which ends its workers; a local worker calls this when it starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_memory()


def _same_tool(client: Client, scheduler: str) -> None:
    """Another version on a worker could write other bytes."""
    try:
        there = set(client.run(_tool).values())
    except ImportError as error:
        raise UsageError(f"--scheduler {scheduler}: its workers lack salpcc-pipeline ({error})") from error
    if there - {TOOL}:
        raise UsageError(
            f"--scheduler {scheduler}: its workers run {', '.join(sorted(there))}, this is {TOOL}"
        )


def check_device(client: Client, device: str) -> None:
    """Refuse a device that a worker lacks.

    Raises:
        UsageError: so it is.
    """
    if device == "cuda" and not all(client.run(_has_cuda).values()):
        raise UsageError("--device cuda: a worker has no GPU that PyTorch can use; leave --device out")


def _has_cuda() -> bool:
    import torch

    return bool(torch.cuda.is_available())


def _tool() -> str:
    return TOOL
