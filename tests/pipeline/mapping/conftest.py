"""A small simulated drive, its archive, and a map of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.mapping.make_map import make_map
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.schemas.config import RunConfig
from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.mapping.config import MapConfig

SEQUENCE, SCANS = "07", 10
CONFIG = MapConfig(voxel=0.2, max_range=40.0, tile=25.0)


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    config = SimulationConfig(sequence=SEQUENCE, scans=SCANS, seed=5, scene="city", movers=12, speed_mps=16.0)
    simulate_sequence(config, folder, load_sensor("hdl64e"))
    return folder


@pytest.fixture(scope="session")
def archive(root: Path) -> Path:
    config = RunConfig(source="simulated", labels="given", keep_movable=True, effort="fast", gop=5)
    graph = GraphOptions(last="residual_code")
    result = run_sequences(
        RunRequest(config, [SEQUENCE], root / "out", root, workers=0, graph=graph, quiet=True)
    )
    assert not result.failed
    return root / "out" / "archives" / f"{SEQUENCE}.mcap"


@pytest.fixture(scope="session")
def poses(root: Path) -> Path:
    return root / "sequences" / SEQUENCE / "poses.txt"


@pytest.fixture(scope="session")
def request_(archive: Path, poses: Path, root: Path) -> Callable[..., MapRequest]:
    def make(out: Path, **changes: object) -> MapRequest:
        plain = MapRequest(
            [archive], out, CONFIG, [str(poses)], formats=["ply"], workers=0, keep_shards=True, quiet=True
        )
        return replace(plain, **changes)  # type: ignore[arg-type]

    return make


@pytest.fixture(scope="session")
def made(request_: Callable[..., MapRequest], root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("map")
    config = CONFIG.model_copy(update={"fill": True})
    make_map(request_(out, config=config, against=root, formats=["laz", "ply", "pcd", "mcap"]))
    return out


@pytest.fixture(scope="session")
def explained(
    request_: Callable[..., MapRequest], made: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A map, in all formats, that says what was removed of it."""
    out = tmp_path_factory.mktemp("explained")
    shutil.copytree(made / "shards", out / "shards")
    make_map(request_(out, formats=["laz", "ply", "pcd", "mcap"], explain=True, keep_shards=False))
    return out
