"""Training makes weights that code, and code better than before training."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.learned.network import load_network
from salpcc.stages.predict.learned.range_model import decode_ranges
from salpcc.stages.predict.learned.recipe import Recipe
from salpcc.stages.predict.learned.train import read_sweeps, train_coder

from .conftest import Returns, range_stream


def coded(path: Path, returns: Returns, sensor: SensorModel) -> int:
    network = load_network(path)
    data = range_stream(returns.starts, returns.tick, returns.count, 1, sensor, network)
    level, sound = decode_ranges(returns.starts, returns.tick, 1, sensor, network, data)
    assert sound
    np.testing.assert_array_equal(level, returns.count)
    return len(data)


def test_more_training_makes_fewer_bytes(
    make_scan: Callable[..., Scan], returns: Returns, sensor: SensorModel, tmp_path: Path
) -> None:
    sweeps = [(scan_to_sweep(make_scan(seed=9, stride=8, motion=None), sensor), None)]
    sizes = []
    for steps in (2, 150):
        recipe = Recipe(
            range_width=16, intensity_width=8, optimiser_steps=steps, intensity_steps=2, batch=512,
            intensity_batch=64,
        )  # fmt: skip
        out = tmp_path / str(steps)
        ranges, _ = train_coder(sweeps, sensor, out, recipe=recipe, log=lambda _: None)
        sizes.append(coded(ranges, returns, sensor))
    assert sizes[1] < 0.95 * sizes[0]


def test_no_sweeps_is_an_error(sensor: SensorModel, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no scans to train on"):
        train_coder([], sensor, tmp_path)


def test_every_scan_is_read_once(make_scan: Callable[..., Scan], sensor: SensorModel, tmp_path: Path) -> None:
    """The simulator's scans lie in the same layout as recorded ones."""
    folder = tmp_path / "sequences/00/velodyne"
    folder.mkdir(parents=True)
    for number in range(2):
        scan = make_scan(seed=number, stride=8)
        columns = [scan.points, scan.intensity[:, None]]
        (folder / f"{number:06d}.bin").write_bytes(np.hstack(columns).astype("<f4").tobytes())
    pairs = list(read_sweeps(tmp_path, sensor))
    assert [sweep.name for sweep, _ in pairs] == ["000000", "000001"]
    assert pairs[0][1] is None and pairs[1][1] is pairs[0][0]
