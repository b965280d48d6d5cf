"""Runs that the tests of the pipeline share."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.schemas.config import RunConfig
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import message_to_scan


def cloud_of(
    rows: NDArray[Any], names: Mapping[str, str] = MappingProxyType({}), topic: str = "", number: int = 0
) -> Scan:
    """A scan recorded as a message of structured rows; ``names`` are recorded names of fields that differ from theirs."""
    kinds = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    fields = []
    for name in rows.dtype.names or ():
        kind, offset = (rows.dtype.fields or {})[name][:2]
        fields.append((names.get(name, name), offset, kinds[kind.base.str[1:]], int(np.prod(kind.shape))))
    time = 1_600_000_000_000_000_000 + number * 100_000_000
    message = CloudMessage(
        time, "lidar", len(rows), rows.tobytes(), point_step=rows.dtype.itemsize, fields=tuple(fields)
    )
    name = f"{topic.strip('/')}-{number:06d}" if topic else f"{number:06d}"
    return message_to_scan(LogMessage(1, time, time, 0, message.to_cdr()), "cdr", topic, name)


@pytest.fixture
def little_room() -> Callable[[], AbstractContextManager[None]]:
    """Where no file may grow beyond 1 kB, as if the disk were full. Not for the whole test: pytest's own output may be a file."""

    @contextmanager
    def limited() -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@pytest.fixture(scope="session")
def run() -> Callable[..., RunResult]:
    """Run sequences in this process: ``run(root, out, "00", max_error=..., graph=...)``."""

    def go(
        root: Path,
        out: Path,
        *sequences: str,
        workers: int = 0,
        graph: GraphOptions | None = None,
        **config: Any,
    ) -> RunResult:
        config = {"gop": 2, "keep_movable": True, **config}
        return run_sequences(
            RunRequest(
                RunConfig(**config),
                list(sequences),
                out,
                root,
                workers,
                graph=graph or GraphOptions(),
                quiet=True,
            )
        )

    return go


@pytest.fixture(scope="session")
def done(toy_root: Path, tmp_path_factory: pytest.TempPathFactory, run: Callable[..., RunResult]) -> Path:
    """Output of an undisturbed run over both toy sequences. Do not write into it."""
    out = tmp_path_factory.mktemp("done")
    result = run(toy_root, out, "00", "01")
    assert not result.failed
    return out
