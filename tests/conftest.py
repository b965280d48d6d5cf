"""Fixtures for all tests: the real scans where they are, and small made-up ones in SemanticKITTI's layout."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from salpcc.schemas.errors import UsageError
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.mapping.open3d_library import load_open3d

settings.register_profile("any machine", deadline=None)  # no test may depend on how fast this one is
settings.load_profile("any machine")

# The compiler makes millions of small objects that stay for a while: a tenth of its time went into looking at them again.
gc.freeze()
gc.set_threshold(20_000, 20, 20)

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
REAL_DATA = Path(os.environ.get("SALPCC_DATA", Path(__file__).parents[2] / "shared" / "data"))
LABELS = np.array([10, 40, 50, 70, 252], np.uint32)  # car, road, building, vegetation, moving car


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real scans; the test is skipped where it is absent."""
    if not (REAL_DATA / "semantickitti").is_dir():
        pytest.skip(f"real scans are not at {REAL_DATA} (set SALPCC_DATA)")
    return REAL_DATA


@pytest.fixture(scope="session")
def open3d() -> None:
    """Skip the test where Open3D does not start, and say what it lacks."""
    try:
        load_open3d()
    except UsageError as error:
        pytest.skip(str(error))


@pytest.fixture
def browser() -> Iterator[Any]:
    """A page of Playwright's, 1000 x 700, in a headless Chromium; the test is skipped where there is none, and fails by errors of scripts.

    SALPCC_CHROMIUM names one that is not on the PATH.
    """
    with pytest.importorskip("playwright.sync_api").sync_playwright() as playwright:
        named = [os.environ.get("SALPCC_CHROMIUM"), *map(shutil.which, BROWSERS)]
        program = next(filter(None, named), playwright.chromium.executable_path)
        if not Path(program).exists():
            pytest.skip("no Chromium on PATH, none named by SALPCC_CHROMIUM")
        options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a graphics card
        chromium = playwright.chromium.launch(executable_path=program, args=options)
        page = chromium.new_page(viewport={"width": 1000, "height": 700})
        errors: list[Any] = []
        page.on("pageerror", lambda error: errors.append(error))
        yield page
        chromium.close()
    assert not errors


@pytest.fixture(scope="session")
def cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """The command line in this process: ``cli("verify", path, cwd=folder)``, with exit code and all that it prints."""
    from salpcc.pipeline.cli.app import main

    def go(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        out, said = StringIO(), StringIO()
        with (
            pytest.MonkeyPatch.context() as patch,
            redirect_stdout(out),
            redirect_stderr(said),
            chdir(cwd or "."),
        ):
            patch.setattr("sys.argv", ["salpcc-pipeline", *map(str, words)])
            for command in ("run_log", "run_sequences", "maps"):  # what ends at once leaves no process behind
                patch.setattr(f"salpcc.pipeline.cli.{command}.start_fork_server", lambda *_, **__: None)
            with pytest.raises(SystemExit) as end:
                main()
        return subprocess.CompletedProcess(words, int(end.value.code or 0), out.getvalue(), said.getvalue())

    return go


def toy_points(sensor: SensorModel, seed: int, firings: int = 160) -> np.ndarray:
    """Points ``(N, 4)`` float32 of a small raw scan: a street of ground and walls, as KITTI would write it."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(0, sensor.ticks_per_turn, sensor.ticks_per_turn // firings)
    laser = np.repeat(np.arange(sensor.n_lasers), len(ticks))
    tick = (np.tile(ticks, sensor.n_lasers) + sensor.shift[laser]) % sensor.ticks_per_turn
    wall = 10.0 + 5.0 * np.sin(tick / 4000 * 6 * np.pi) + seed % 3
    ground = 1.73 / np.maximum(-np.sin(sensor.theta[laser]), 0.02)
    distance = np.minimum(wall, ground) + rng.normal(0, 0.01, len(tick))
    count = np.rint((distance - sensor.d0[laser]) / sensor.count)
    seen = rng.random(len(tick)) < 0.9
    model = unproject(sensor, laser[seen].astype(np.uint8), tick[seen].astype(np.int32), count[seen])
    order = np.lexsort((azimuth_keys(model), laser[seen]))
    points = (np.rint(model[order] * 1000) / 1000).astype(np.float32)
    intensity = (rng.integers(0, 60, len(points)) / 100).astype(np.float32)
    return np.column_stack([points, intensity])


def write_toy_sequence(root: Path, sequence: str, numbers: list[int]) -> None:
    """Write small scans, their labels and times in SemanticKITTI's layout."""
    sensor = load_sensor("hdl64e")
    folder = root / "sequences" / sequence
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    for number in numbers:
        rows = toy_points(sensor, seed=100 * int(sequence) + number)
        rows.astype("<f4").tofile(folder / "velodyne" / f"{number:06d}.bin")
        labels = np.random.default_rng(number).choice(LABELS, len(rows)) | (7 << 16)
        labels.astype("<u4").tofile(folder / "labels" / f"{number:06d}.label")
    times = "".join(f"{0.1 * n:.6e}\n" for n in range(max(numbers) + 1))
    (folder / "times.txt").write_text(times)


@pytest.fixture(scope="session")
def toy_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences: 00 with scans 0 to 4, 01 with 0, 1 and 7 (a gap). Do not write into it."""
    root = tmp_path_factory.mktemp("toy")
    write_toy_sequence(root, "00", [0, 1, 2, 3, 4])
    write_toy_sequence(root, "01", [0, 1, 7])
    return root


@pytest.fixture(scope="session")
def toy() -> Callable[[Path, str, list[int]], Path]:
    """Make a sequence of small scans by their numbers: ``toy(root, "00", [0, 1, 2])``; returns the root."""

    def make(root: Path, sequence: str, numbers: list[int]) -> Path:
        write_toy_sequence(root, sequence, numbers)
        return root

    return make
