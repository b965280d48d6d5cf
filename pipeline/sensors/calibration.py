"""Fit a sensor model to recorded scans: read them, undo KITTI's motion where there is any, fit, say how well it does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from salpcc.schemas.errors import SensorError, SourceError, UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.calibrate.fit_sensor import Fit, fit_sensor, share_exact
from salpcc.stages.ingest.point_cloud import times_of
from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.ingest.sources.velodyne_bin import read_points, read_points_with_rings
from salpcc.stages.lattice.find_lasers import Listed
from salpcc.stages.lattice.motion_search import is_raw, solve_motion
from salpcc.stages.lattice.untwist import untwist

_LEAST_FOR_MOTION = 200


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fit, the scans that it was made of and those left out, and the share of points that it gives back to the millimetre.

    ``exact`` is None where coordinates are no whole millimetres.
    """

    fit: Fit
    scans: int
    left_out: int
    exact: float | None


def calibrate_log(log: Path, at_most: int, name: str, topics: tuple[str, ...] = ()) -> Calibration:
    """Fit a sensor model to the scans of a log, or to the ``.bin`` and ``.pcd.bin`` scans in a folder or below it.

    Args:
        at_most: number of scans to use, evenly spread over all.
        name: of the new model.
        topics: of a log, where it has clouds of more than one.

    Raises:
        UsageError: no scans there, or clouds of several topics.
        SensorError: the scans are not of one spinning sensor.
    """
    try:
        return calibrate_scans(list(_scans_of(log, at_most, topics)), name)
    except SensorError as error:
        raise SensorError(f"{log}: {error}") from error


def calibrate_scans(listed: list[Listed], name: str) -> Calibration:
    """Fit a sensor model to scans.

    Raises:
        SensorError: they are not of one spinning sensor.
    """
    raw = [_raw(scan) for scan in listed]
    rounded = 2 * sum(scan is not None for scan in raw) > len(listed)
    kept = [scan for scan in raw if scan is not None] if rounded else [s for s in listed if len(s.points)]
    if not kept:
        raise SensorError(
            f"no points in its {len(listed)} scans; is it a scan of float32 x, y, z, intensity?"
        )
    fit = fit_sensor(kept, name, rounded)
    if not rounded:
        return Calibration(fit, len(kept), len(listed) - len(kept), None)
    exact = share_exact(fit)
    fit = replace(fit, model=replace(fit.model, bit_identical_share=round(exact, 6)))
    return Calibration(fit, len(kept), len(listed) - len(kept), exact)


def summary(found: Calibration) -> list[str]:
    """Say in a few lines what was found and how well it fits."""
    fit, model = found.fit, found.fit.model
    elevation = np.degrees(model.theta)
    levers = [f"{1000 * np.abs(values).max():.1f}" for values in (model.h, model.z0, model.d0)]
    rare = f", {fit.missing} more with too few points" if fit.missing else ""
    ticks = f"{model.ticks_per_turn} ticks a turn, {360 / model.ticks_per_turn:.4f} deg"
    count = f"{1000 * model.count:g} mm"
    shares = ", ".join(f"{fit.share_within(mm / 1000):.1%} within {mm} mm" for mm in (1, 5, 20))
    lines = [
        (
            f"{model.n_lasers} lasers at {elevation.min():.2f} to {elevation.max():.2f} deg{rare}, "
            f"from {found.scans} scans ({found.left_out} left out)"
        ),
        f"azimuth step: {ticks} (coherence {fit.ticks_line:.2f})"
        if fit.ticks_line
        else f"azimuth step: none found; {ticks}",
        f"range step: {count} (coherence {fit.count_line:.2f})"
        if fit.count_line
        else f"range step: none found; {count}",
        f"largest lever arms: {levers[0]} mm sideways, {levers[1]} mm up, {levers[2]} mm along the beam",
        f"misfit of {len(fit.off)} points: median {1000 * np.median(fit.off):.3g} mm; {shares}",
    ]
    if fit.moved:
        lines.append(f"motion during the turn: undone in {fit.moved} scans")
    if model.driver is not None:
        lines.append(f"driver: {model.driver.formula}, sines {model.driver.sine}")
    if model.bit_identical_share is not None:
        lines.append(f"bit_identical_share: {model.bit_identical_share:.4%} of all returns")
    if found.exact is not None:
        lines.append(f"gives {found.exact:.2%} of the points back to the millimetre")
    return lines


def _scans_of(log: Path, at_most: int, topics: tuple[str, ...]) -> Iterator[Listed]:
    """Read scans, evenly spread; what cannot be read has no points."""
    names = Bag().sequences(log) if log.exists() else []
    if log.suffix in (".mcap", ".bag") or (len(names) == 1 and not _bins(log)):
        bag = Bag()
        refs = bag.scans(log, names[0] if names else log.stem, topics)
        if len({ref.topic for ref in refs}) > 1:
            raise UsageError(
                f"{log}: clouds on {', '.join(sorted({r.topic for r in refs}))}; choose one with --topic"
            )
        for ref in _spread(refs, at_most):
            yield listed_of(bag.read(ref, with_labels=False))
        return
    files = [log] if log.is_file() else _bins(log)
    if not files:
        raise UsageError(f"{log}: no .bin or .pcd.bin scans found there or below, and no log. {Bag.hint}")
    for file in _spread(files, at_most):
        try:
            if file.name.endswith(".pcd.bin"):
                points, _, ring = read_points_with_rings(file)
                yield Listed(points.astype(np.float64), ring)
            else:
                yield Listed(read_points(file)[0].astype(np.float64))
        except SourceError:
            yield Listed(np.zeros((0, 3)))


def _bins(folder: Path) -> list[Path]:
    """The ``.bin`` files in a folder and below it, without hidden ones."""
    return sorted(file for file in folder.rglob("*.bin") if not file.name.startswith("."))


def listed_of(scan: Scan) -> Listed:
    """Take a scan of a log as calibration wants it: ring numbers and rows where the message has them."""
    points, cloud = scan.points.astype(np.float64), scan.cloud
    if cloud is None:
        return Listed(points)
    layout = cloud.layout
    ring = cloud.rings()
    width = layout.width if cloud.whole and layout.height > 1 else 0
    return Listed(points, ring, width, times_of(cloud))


def _spread(things: list[Any], at_most: int) -> list[Any]:
    if not things:
        return []
    return [
        things[i] for i in np.unique(np.linspace(0, len(things) - 1, min(at_most, len(things))).astype(int))
    ]


def _raw(scan: Listed) -> Listed | None:
    """The points of a scan as whole millimetres, KITTI's motion undone; None where that cannot be done."""
    points = scan.points.astype(np.float32)
    if not np.isfinite(points).all() or np.count_nonzero(points.any(axis=1)) < _LEAST_FOR_MOTION:
        return None
    motion = None
    returns = points[points.any(axis=1)]  # what is no return lies on any lattice
    if not is_raw(returns):
        try:
            motion = solve_motion(returns)
        except np.linalg.LinAlgError:  # nothing like a turn of a sensor
            return None
        if motion is None:
            return None
    found = untwist(points, motion)
    explained = found.explained
    ring = None if scan.ring is None else scan.ring[explained]
    return Listed(found.raw[explained] / 1000.0, ring, scan.width if explained.all() else 0)
