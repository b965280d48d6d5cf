"""Run baselines in a process of their own, so that one that hangs, crashes or eats memory costs its row only.

The process is kept for the next measurement, as imports and compilation take longer than most codecs; where
it does not answer in time it is killed, with every program that it started, and a new one begins.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import pyarrow as pa

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines.baseline import Baseline
from salpcc.stages.evaluate.baselines.measure_baseline import Row, asked_errors, empty_row, measure, warm_up
from salpcc.stages.evaluate.report.schema import BASELINES as BASELINES_SCHEMA

LIMIT_S = 60.0  # wall-clock seconds a scan
_START_S = 60.0  # more for the first scan of a codec: imports, compilation
REGISTRY = "salpcc.stages.evaluate.baselines:BASELINES"


def measure_scans(
    name: str,
    scans: Iterable[Scan],
    sequence: str,
    limit_s: float = LIMIT_S,
    registry: str = REGISTRY,
    errors: Sequence[float] | None = None,
) -> pa.Table:
    """Measure a baseline at each of its errors on each scan: a BASELINES table, one task of a run.

    Never raises for what the codec does. One that took too long is not tried on the rest of these scans.
    """
    baseline = _registry(registry)[name]
    rows: list[Row] = []
    too_long = ""
    rest = iter(scans)
    while group := list(islice(rest, baseline.together().size)):
        for error in asked_errors(baseline) if errors is None else errors:
            if missing := baseline.missing():
                status = f"not run: {missing}"
            elif too_long:
                status = f"failed: not tried again, {too_long}"
            else:
                answer = _worker(registry).ask(name, group, sequence, error, limit_s)
                if not isinstance(answer, str):
                    rows += answer
                    continue
                status = f"failed: {answer}"
                too_long = answer if answer.startswith("took") else ""
            rows += [empty_row(name, scan, sequence, error, status) for scan in group]
    return pa.Table.from_pylist(rows, schema=BASELINES_SCHEMA)


class Apart:
    """A process that measures what it is asked to, and the line to it."""

    def __init__(self, registry: str) -> None:
        self.registry = registry
        self._started: set[str] = set()
        self._line, theirs = Pipe()
        command = [sys.executable, "-m", __name__, str(theirs.fileno()), registry]
        self._process = subprocess.Popen(
            command,
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()

    @property
    def alive(self) -> bool:
        """Tell whether it can be asked."""
        return self._process.poll() is None

    def ask(
        self, name: str, scans: list[Scan], sequence: str, error: float, limit_s: float
    ) -> list[Row] | str:
        """Return the rows of one measurement, or why there are none."""
        allowed = limit_s * len(scans)
        patience = allowed + (0.0 if name in self._started else min(_START_S, 10 * limit_s))
        self._started.add(name)
        try:
            self._line.send((name, scans, sequence, error, patience))
            if self._line.poll(patience):
                rows: list[Row] = self._line.recv()
                return rows
        except (EOFError, OSError):
            return self._cause_of_death()
        self.end()
        return f"took more than {allowed:g} s for {len(scans)} scan{'s' if len(scans) > 1 else ''}"

    def end(self) -> None:
        """Kill it, and what it started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._line.close()

    def _cause_of_death(self) -> str:
        try:
            code = self._process.wait(5)
        except subprocess.TimeoutExpired:
            code = 0
        self.end()
        how = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return f"its process ended {how}"


_kept: list[Apart] = []


def _worker(registry: str) -> Apart:
    """Return the process that this one keeps, or a new one."""
    if _kept and not (_kept[0].alive and _kept[0].registry == registry):
        _kept.pop().end()
    if not _kept:
        _kept.append(Apart(registry))
    return _kept[0]


def _registry(name: str) -> Mapping[str, Baseline]:
    module, _, attribute = name.partition(":")
    baselines: Mapping[str, Baseline] = getattr(import_module(module), attribute)
    return baselines


def serve(line: Connection, registry: str) -> None:
    """Answer until the other end is gone; the first time a codec is asked for, it warms up.

    An alarm ends a process whose parent died while a codec hangs.
    """
    baselines, warm = _registry(registry), set[str]()
    while True:
        try:
            name, scans, sequence, error, patience = line.recv()
        except EOFError:
            return
        signal.alarm(int(patience) + 10)
        if name not in warm:
            warm.add(name)
            warm_up(baselines[name], scans, error)
        line.send(measure(name, baselines[name], scans, sequence, error))
        signal.alarm(0)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), sys.argv[2])
