"""The process that workers are forked from: it loads once what each of them needs, while the command itself still loads."""

from __future__ import annotations

import os
import signal
import sys
import threading
from multiprocessing import forkserver

# One thread a worker, so that workers scale; libraries ask when they are loaded.
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
METHOD = (
    "forkserver" if sys.platform == "linux" else "spawn"
)  # macOS' own libraries break in a forked process
_LOADED = ["distributed.nanny", "salpcc.pipeline.cli.app", "salpcc.pipeline.graph.sequence"]
_NETWORK = ["salpcc.stages.segment.network.checkpoint", "salpcc.stages.segment.segmenter"]


def start_fork_server(workers: int | None, scheduler: str | None, network: bool = False) -> None:
    """Start it, where :func:`~salpcc.pipeline.schedule.cluster.connect` will fork workers and it does not run yet.

    Returns at once: a command calls this before it loads libraries of its own.

    Args:
        workers, scheduler: as of ``connect``.
        network: whether workers will ask the segmentation network, so that PyTorch is loaded, too.

    Raises:
        OSError: no process can be started.
    """
    if METHOD != "forkserver" or workers == 0 or scheduler is not None:
        return
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    main = threading.current_thread() is threading.main_thread()
    # What is ignored stays so in the new process: Ctrl-C is the run's, which ends its workers.
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    os.environ.update(ENVIRONMENT)
    try:
        forkserver.set_forkserver_preload(_LOADED + (_NETWORK if network else []))
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if main:
            signal.signal(signal.SIGINT, handler)
