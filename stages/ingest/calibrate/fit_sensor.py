"""Fit a sensor model to scans of a sensor that nothing is known of: lasers, steps, five numbers per laser, shifts.

Points of a laser lie on a cone; their azimuths are whole ticks and their ranges whole counts, more or less. What has
none of these steps still gets a model of fine ones: then directions are known to a tick, and no better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SensorError
from salpcc.stages.ingest.calibrate.find_driver import find_driver, share_identical
from salpcc.stages.ingest.calibrate.fit_laser import fit_laser
from salpcc.stages.ingest.calibrate.fit_moved import settle, undo_known, undo_unknown
from salpcc.stages.lattice.aim import aim, share_on
from salpcc.stages.lattice.find_lasers import Listed, find_lasers, with_lasers
from salpcc.stages.lattice.find_steps import find_count, find_ticks
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.list_motion import fit_cones, places, solve, undo
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel, load_sensor

_MOST_POINTS = 150_000  # per laser
_LEAST_POINTS = 50
_REASSIGNED = 0.01  # metres from another laser's cone
_WORTH_IT = 0.5  # of the misfit of the cones, that undoing a motion leaves
_EXPLAINED = 0.02  # metres
_LEAST_EXPLAINED, _LEAST_LASERS = 0.5, 0.7  # of the returns, and of the lasers, of any scan
_COLUMNS = {512, 1024, 2048, 4096}  # of organised clouds
_PROVEN, _SURE = 0.9, 0.99  # of all returns, that come back to the bit
_STILL = 2e-5  # metres from the lattice; what is farther was moved, or is rounded
_SETTLED = 2  # times that motions and model are fitted to each other
_JITTER = 2  # ticks within a firing
_HOLDS, _CLOSE = 0.8, 0.002  # of all returns, whosever; metres

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, and how well it fits.

    Attributes:
        missing: lasers that were seen, but too rarely to be fitted.
        ticks_line, count_line: coherence of azimuths and ranges at the steps of the model, 0 to 1; 0: no such steps.
        moved: scans whose motion had to be undone.
        raw, laser: points ``(N, 3)`` and their lasers ``(N,)`` per scan, motion undone; -1 is no return of a fitted laser.
        off: distance of each return of all scans from its model point, metres.
    """

    model: SensorModel
    missing: int
    ticks_line: float
    count_line: float
    moved: int
    raw: list[F64]
    laser: list[I64]
    off: F64

    def share_within(self, metres: float) -> float:
        """Share of the returns that the model explains so well."""
        return float((self.off <= metres).mean())


def fit_sensor(scans: Sequence[Listed], name: str, rounded: bool) -> Fit:
    """Fit a model to scans, the motion of KITTI's kind undone.

    Args:
        rounded: coordinates are whole millimetres.

    Raises:
        SensorError: too few points, no cones, or scans that are not of one sensor.
    """
    kept = [scan for scan in scans if len(scan.points)]
    if not kept:
        raise SensorError("no scan to calibrate on")
    kept = with_lasers(kept)
    fit, error = None, None
    try:
        fit = _fitted(kept, name, rounded)
    except SensorError as found:
        error = found
    least = 0.0 if fit is None else fit.model.bit_identical_share or 0.0
    if not rounded and least < _SURE:
        fit = _fit_shipped(kept, name, least) or _fit_moved(kept, name, fit) or fit
    if fit is None:
        raise error or SensorError("no sensor is found")
    return fit


def _fit_shipped(scans: list[Listed], name: str, least: float) -> Fit | None:
    """A shipped model, where most of all returns lie on its lattice, and it gives back more of them to the bit than ``least``."""
    points = [scan.points.astype(np.float32) for scan in scans]
    for sensor in (load_sensor(file.stem) for file in sorted(SENSORS.glob("*.json"))):
        if sensor.driver is None or not share_on(sensor, points[0]) > _PROVEN:
            continue
        share = share_identical(sensor, np.concatenate(points))
        if share > least:
            return _fit_of(replace(sensor, name=name, bit_identical_share=round(share, 6)), scans)
    return None


def _fit_of(model: SensorModel, scans: list[Listed], moved: int = 0) -> Fit:
    """The fit that scans, their motion undone, are of a model that was there before."""
    aimed = [aim(model, scan.points) for scan in scans]
    off = np.concatenate([a[3][scan.seen] for a, scan in zip(aimed, scans, strict=True)])
    return Fit(model, 0, 1.0, 1.0, moved, [scan.points for scan in scans], [a[0] for a in aimed], off)


def _fit_moved(scans: list[Listed], name: str, still: Fit | None) -> Fit | None:
    """Fit a model to scans that were moved by their points' times, unless ``still`` fits; None where no such motion is found."""
    if any(scan.time is None for scan in scans) or (still is not None and np.median(still.off) <= _STILL):
        return None
    known = undo_known(scans, name)
    if known is not None:
        return _fit_of(*known, len(scans))
    undone = undo_unknown(scans)
    if undone is None:
        return None
    raw, moves = undone
    for _ in range(_SETTLED):
        raw = settle(_fitted(raw, name, False).model, scans, moves)
    return replace(_fitted(raw, name, False), moved=len(raw))


def _fitted(kept: list[Listed], name: str, rounded: bool) -> Fit:
    laser, firing = find_lasers(kept)
    lasers = 1 + max(int(k.max()) for k in laser)
    raw, ticks, count, moved = _undone([scan.points for scan in kept], laser, lasers, firing)
    laser = _on_cones(raw, laser, lasers)
    enough = np.sum([np.bincount(k[k >= 0], minlength=lasers) for k in laser], axis=0)
    good = np.flatnonzero(enough >= _LEAST_POINTS)
    if len(good) <= lasers // 2:
        k = int(enough.argmin())
        raise SensorError(f"laser {k} has {enough[k]} points, {_LEAST_POINTS} are needed: use more scans")
    own = [np.concatenate([q[k == j] for q, k in zip(raw, laser, strict=True)]) for j in good]
    found_ticks, ticks_line = find_ticks(own)
    cones = [fit_cones(q, np.zeros(len(q), np.int64), 1)[0] for q in own]
    found_count, count_line = find_count(
        [_along(q, float(c.slope[0]), float(c.height[0])) for q, c in zip(own, cones, strict=True)]
    )
    widths = {scan.width for scan in kept}
    if len(widths) == 1 and widths <= _COLUMNS and (not ticks_line or found_ticks % min(widths) == 0):
        # Too few returns to tell, or to tell from a multiple, but the cloud is a turn of so many columns.
        found_ticks = widths.pop()
    ticks, count = ticks or found_ticks, count or found_count
    fitted = [fit_laser(q[:: len(q) // _MOST_POINTS + 1], ticks, count, rounded) for q in own]
    # A nanoradian at 100 m and a tenth of a micrometre say no more; short numbers keep archives short.
    theta, z0, h, phi0, d0 = (
        np.round(c, n) for c, n in zip(np.array(fitted).T, (9, 7, 7, 9, 7), strict=True)
    )
    model = SensorModel(name, ticks, count, theta, z0, h, phi0, d0, np.zeros(len(good), np.int64))
    renumbered = np.full(lasers + 1, -1)
    renumbered[good] = np.arange(len(good))
    laser = [renumbered[k] for k in laser]
    aimed = [aim(model, q, k) for q, k in zip(raw, laser, strict=True)]
    model = SensorModel(name, ticks, count, theta, z0, h, phi0, d0, find_shifts(model, aimed, laser))
    off = [a[3][k >= 0] for a, k in zip(aimed, laser, strict=True)]
    _check(off, laser, len(good))
    _check_all(off, kept)
    if not rounded and not moved:
        model = _driven(model, raw, laser)
    return Fit(model, lasers - len(good), ticks_line, count_line, moved, raw, laser, np.concatenate(off))


def share_exact(fit: Fit, model: SensorModel | None = None) -> float:
    """Share of the returns of a fit that its model, or another of as many lasers, gives back to the millimetre."""
    model = model or fit.model
    exact = total = 0
    for raw, laser in zip(fit.raw, fit.laser, strict=True):
        seen = laser >= 0
        k, tick, count, _ = aim(model, raw[seen], laser[seen])
        back = unproject(model, k.astype(np.uint8), tick.astype(np.int32), count.astype(np.float64))
        exact += int((np.rint(back * 1000.0) == np.rint(raw[seen] * 1000.0)).all(axis=1).sum())
        total += int(seen.sum())
    return exact / max(total, 1)


def _undone(
    points: list[F64], laser: list[I64], lasers: int, firing: int
) -> tuple[list[F64], int, float, int]:
    """Undo the motion of scans that list firings, where it can be told; with the ticks and count that told it, else 0."""
    if not firing:
        return points, 0, 0.0, 0
    raw, ticks, count, moved = [], 0, 0.0, 0
    for q, k in zip(points, laser, strict=True):
        s = places(len(q), firing)
        found = solve(q, k, s, lasers)
        undone = q if found is None else undo(q, s, found.motion)
        if found is None or _misfit(undone, k, lasers) > _WORTH_IT * _misfit(q, k, lasers):
            raw.append(q)
            continue
        raw.append(undone)
        ticks, count, moved = found.ticks, found.count, moved + 1
    return raw, ticks, count, moved


def _misfit(q: F64, laser: I64, lasers: int) -> float:
    seen = laser >= 0
    return float(np.median(np.abs(fit_cones(q[seen], laser[seen], lasers)[1])))


def _on_cones(raw: list[F64], laser: list[I64], lasers: int) -> list[I64]:
    """Give points that lie on another laser's cone to that one: where a list of rings was cut is a guess."""
    every, of = np.concatenate(raw), np.concatenate(laser)
    seen = of >= 0
    cones, off = fit_cones(every[seen], of[seen], lasers)
    astray = np.flatnonzero(seen)[np.abs(off) > _REASSIGNED]
    rho = np.hypot(every[astray, 0], every[astray, 1])
    apart = np.abs(every[astray, 2, None] - rho[:, None] * cones.slope - cones.height)
    of[astray] = np.where(apart.min(axis=1) < _REASSIGNED, apart.argmin(axis=1), -1) if len(astray) else -1
    return np.split(of, np.cumsum([len(q) for q in raw])[:-1])


def _along(q: F64, slope: float, height: float) -> F64:
    """Distance along the beam of points on a cone."""
    theta = np.arctan(slope)
    return np.asarray(np.hypot(q[:, 0], q[:, 1]) * np.cos(theta) + (q[:, 2] - height) * np.sin(theta))


def find_shifts(model: SensorModel, aimed: list[tuple[I64, I64, I64, F64]], laser: list[I64]) -> I64:
    """Ticks between the common firing and each laser's ``(L,)``: the peak of the correlation of their ticks."""
    ticks = model.ticks_per_turn
    chosen = range(min(len(aimed), max(1, (1 << 22) // (ticks * model.n_lasers))))
    spectra = np.empty((len(chosen), model.n_lasers, ticks), np.complex64)
    for i in chosen:
        fired = np.zeros((model.n_lasers, ticks), np.float32)
        seen = laser[i] >= 0
        fired[laser[i][seen], aimed[i][1][seen]] = 1
        spectra[i] = np.fft.fft(fired - fired.mean(axis=-1, keepdims=True), axis=-1)
    reference = spectra[:, model.n_lasers // 2]
    shift = np.zeros(model.n_lasers, np.int64)
    turn = np.exp(-2j * np.pi * np.arange(ticks) / ticks).astype(np.complex64)
    for _ in range(3):
        together = np.zeros_like(reference)
        for k in range(model.n_lasers):
            correlation = np.fft.ifft(spectra[:, k] * reference.conj(), axis=-1).real.sum(axis=0)
            shift[k] = (int(correlation.argmax()) + ticks // 2) % ticks - ticks // 2
            together += spectra[:, k] * turn[(-shift[k] * np.arange(ticks)) % ticks]
        reference = together
    return shift


def _driven(model: SensorModel, raw: list[F64], laser: list[I64]) -> SensorModel:
    """Add the driver of the sensor, if one is found, and the share of all returns that comes back bit for bit."""
    points = np.concatenate(raw).astype(np.float32)
    found = find_driver(model, points, np.concatenate(laser))
    if found is not None and share_identical(found, points) > share_identical(model, points):
        aimed = [aim(found, q, k) for q, k in zip(raw, laser, strict=True)]
        listed = [(k[k >= 0], a[1][k >= 0]) for k, a in zip(laser, aimed, strict=True)]
        shifts = [_listed_shifts(found, listed), find_shifts(found, aimed, laser)]
        model = replace(
            found, shift=min(shifts, key=lambda shift: _jumps(listed, shift, found.ticks_per_turn))
        )
    return replace(model, bit_identical_share=round(share_identical(model, points), 6))


def _listed_shifts(model: SensorModel, scans: list[tuple[I64, I64]]) -> I64:
    """Ticks between the common firing and each laser's ``(L,)``, from the lasers that follow one another in lists ``(laser, tick)``.

    Within a firing two lasers are always as far apart; the pairs that are seen most often connect them all.
    """
    lasers, ticks = model.n_lasers, model.ticks_per_turn
    shift = np.zeros(lasers, np.int64)
    pairs, hops = [], []
    for k, t in scans:
        pairs.append(k[:-1] * lasers + k[1:])
        hops.append((t[1:] - t[:-1] + ticks // 2) % ticks - ticks // 2)
    pair, hop = np.concatenate(pairs), np.concatenate(hops)
    group = np.arange(lasers)
    for edge in np.argsort(-np.bincount(pair, minlength=lasers * lasers), kind="stable")[: 4 * lasers]:
        a, b = divmod(int(edge), lasers)
        own = hop[pair == edge]
        if group[a] == group[b] or not len(own):
            continue
        values, counts = np.unique(own, return_counts=True)
        joined = group == group[b]
        shift[joined] += shift[a] + values[counts.argmax()] - shift[b]
        group[joined] = group[a]
    return np.asarray((shift + ticks // 2) % ticks - ticks // 2)


def _jumps(scans: list[tuple[I64, I64]], shift: I64, ticks: int) -> int:
    """How often the common firing of the next point of a list is another one."""
    phases = [(tick - shift[laser]) % ticks for laser, tick in scans]
    return sum(int((np.abs((np.diff(p) + ticks // 2) % ticks - ticks // 2) > _JITTER).sum()) for p in phases)


def _check_all(off: list[F64], scans: Sequence[Listed]) -> None:
    """Refuse a model that holds for those points only that were given to its lasers."""
    seen = sum(int(scan.seen.sum()) for scan in scans)
    close = sum(int((distance <= _CLOSE).sum()) for distance in off)
    if close < _HOLDS * seen:
        raise SensorError(
            f"only {close / seen:.0%} of all returns lie within {1000 * _CLOSE:g} mm of the lasers that were found: "
            "the clouds are of two sensors, thinned, moved in a way that is not understood, or of a sensor that is not known"
        )


def _check(off: list[F64], laser: list[I64], lasers: int) -> None:
    """Refuse scans that the model of all of them does not explain, or that have few of its lasers."""
    shares = [float((distance <= _EXPLAINED).mean()) for distance in off if len(distance)]
    if not shares or np.median(shares) < _LEAST_EXPLAINED:
        share = np.median(shares) if shares else 0.0
        raise SensorError(
            f"only {share:.0%} of the points lie within 20 mm of a lattice of lasers: "
            "the scans are moved in a way that is not understood, or of no spinning LiDAR"
        )
    usual = np.median([len(distance) for distance in off])
    for scan, (distance, k) in enumerate(zip(off, laser, strict=True)):
        if len(distance) < usual / 4:
            continue
        share, seen = float((distance <= _EXPLAINED).mean()), len(np.unique(k[k >= 0]))
        if share < _LEAST_EXPLAINED or seen < _LEAST_LASERS * lasers:
            raise SensorError(
                f"scan {scan} (of those used) shows {seen} of {lasers} lasers and fits in {share:.0%} of its points: "
                "the scans are of different sensors; calibrate on one at a time"
            )
