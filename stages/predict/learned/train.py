"""Train the learned range and intensity models on sweeps (CPU, minutes). Needs torch; decoding does not.

The loss is the code length itself: for ranges the mixture's probability of the coded level, for
intensity that of the coded value. Activations are clipped to what the integer network can hold, so
rounding the weights afterwards costs under 0.005 bits a point and no retraining.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salpcc.schemas.errors import UsageError
from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.learned.intensity_model import collect_intensity
from salpcc.stages.predict.learned.network import Network, save_network
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, warp
from salpcc.stages.predict.learned.quantise import quantize_network
from salpcc.stages.predict.learned.range_model import collect_ranges
from salpcc.stages.predict.learned.recipe import RECIPES, Recipe, Rows
from salpcc.stages.predict.sweep_walk import supports

if TYPE_CHECKING:
    import torch

Log = Callable[[str], None]
Pair = tuple[Sweep, Sweep | None]  # and the one before


STEPS = (5, 10, 20)
ODD_STEPS = (2, 3, 4, 7, 9, 14, 19, 30, 50)


def read_sweeps(root: Path, sensor: SensorModel) -> Iterator[Pair]:
    """Read every scan of every source below ``root`` onto its lattice, each with the one before, if any.

    Scans that do not fit are left out. What the simulator writes is read as the recorded scans whose layout it has.
    """
    for name, source in SOURCES.items():
        if name == "simulated":
            continue
        for sequence in source.sequences(root):
            before = motion = None
            for reference in source.scans(root, sequence):
                sweep = scan_to_sweep(source.read(reference, with_labels=False), sensor, motion)
                motion = sweep.motion
                if len(sweep.laser):
                    yield sweep, before
                before = sweep


def collect(sweeps: Iterable[Pair], sensor: SensorModel, recipe: Recipe) -> tuple[Rows, Rows]:
    """Gather training rows of ranges and of intensities from lossless sweeps.

    Raises:
        UsageError: the sensor is not one the features fit, or there are no sweeps.
    """
    if not supports(sensor):
        raise UsageError(
            f"--sensor {sensor.name}: the networks are for 64 lasers, 4000 ticks and 2 mm counts; --effort fast has tables for any"
        )
    rng = np.random.default_rng(recipe.seed)
    ranges: list[Rows] = []
    values: list[Rows] = []
    for number, (sweep, before) in enumerate(sweeps):
        starts = np.searchsorted(sweep.laser, np.arange(sensor.n_lasers + 1)).astype(np.int64)
        odd = ODD_STEPS[number % len(ODD_STEPS)]
        shares = [(1, recipe.share)] + [(step, recipe.coarse_share) for step in (*STEPS, odd)]
        for step, share in shares:
            keep = rng.random(len(sweep.laser)) < share
            level = (sweep.count // step).astype(np.int32)
            seen = _seen(sweep, before, step, sensor) if recipe.looks_back else None
            x, mu, y = collect_ranges(starts, sweep.tick, level, step, sensor, keep, seen)
            ranges.append(
                {"x": x, "mu": mu, "y": y, "step": np.full(len(y), step), "laser": sweep.laser[keep]}
            )
        intensity = np.rint(sweep.intensity * 100).astype(np.uint8)
        for step, share in ((1, recipe.share / 2), (STEPS[number % 3], recipe.coarse_share / 2)):
            keep = rng.random(len(sweep.laser)) < share
            level = (sweep.count // step).astype(np.int32)
            seen = _seen(sweep, before, step, sensor) if recipe.looks_back else None
            x, side = collect_intensity(starts, sweep.tick, level, step, intensity, sensor, keep, seen)
            values.append({"x": x, "side": side, "y": intensity[keep], "laser": sweep.laser[keep]})
    if not ranges:
        raise UsageError("no scans to train on; name the root of some with --data")
    return _join(ranges), _join(values)


def _seen(sweep: Sweep, before: Sweep | None, step: int, sensor: SensorModel) -> WarpedSweep:
    """The lossless sweep before, as an archive of that step would have it, seen from a sweep."""
    if before is not None:
        before = replace(before, count=(before.count // step).astype(np.int32), step=step)
    return warp(before, sweep.motion, sensor)


def _join(rows: list[Rows]) -> Rows:
    return {name: np.concatenate([part[name] for part in rows]) for name in rows[0]}


def train_coder(
    sweeps: Iterable[Pair],
    sensor: SensorModel,
    out: Path,
    effort: str = "default",
    recipe: Recipe | None = None,
    log: Log = print,
) -> tuple[Path, Path]:
    """Train both networks of an effort level and write ``range_EFFORT.npz`` and ``intensity_EFFORT.npz``."""
    from salpcc.stages.predict.learned.torch_models import fit  # here: coding never imports torch

    recipe = recipe or RECIPES[effort]
    ranges, values = collect(sweeps, sensor, recipe)
    out.mkdir(parents=True, exist_ok=True)
    paths = out / f"range_{effort}.npz", out / f"intensity_{effort}.npz"
    log(f"ranges: {len(ranges['y'])} returns, width {recipe.range_width}")
    save_network(paths[0], export(fit("ranges", ranges, recipe, log)))
    log(f"intensity: {len(values['y'])} returns, width {recipe.intensity_width}")
    save_network(paths[1], export(fit("intensity", values, recipe, log)))
    return paths


def export(net: torch.nn.Module) -> Network:
    """Round a trained float network of :mod:`.torch_models` to integers."""
    state = {name: value.detach().double().numpy() for name, value in net.state_dict().items()}
    names = sorted(name[:-7] for name in state if name.startswith("layers.") and name.endswith(".weight"))
    layers = [(state[f"{name}.weight"].T, state[f"{name}.bias"]) for name in names]
    tables = [state[name] for name in sorted(state) if name.startswith("tables.")]
    return quantize_network(layers, tables, state.get("last_table.weight"))
