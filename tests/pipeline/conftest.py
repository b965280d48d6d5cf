"""Runs that the tests of the pipeline share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from salpcc.pipeline.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.schemas.config import RunConfig


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
