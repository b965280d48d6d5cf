"""Fit the five numbers of one laser to its points.

docs/sensor_lattice.md, section 1: Gauss-Newton on all residuals, ticks and counts rounded in the loop. Where coordinates were rounded
to 1 mm, their noise is uniform and bounded: a second fit looks only at coordinates beyond half a millimetre, which the right
parameters do not have. That takes the points of KITTI that need no correction from 98.8 to 99.7 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_HALF = 0.0005  # metres, half the step of rounded coordinates
_FAR_OFF = 0.0025  # residuals beyond this are not of this laser
_TIGHTER = 5.0  # times the median, at last

F64 = NDArray[np.float64]


def fit_laser(q: F64, ticks: int, count: float, rounded: bool) -> F64:
    """Fit (theta, z0, h, phi0, d0) to the points ``(N, 3)`` of one laser, in metres; ``rounded``: to whole millimetres."""
    p = _start(q, ticks, count)
    reach = _FAR_OFF
    for again in range(12):
        e, jacobian = _residuals(q, p, ticks, count)
        ok = np.abs(e).max(axis=1) < reach
        if ok.sum() < 5:
            return p
        p = p + np.linalg.lstsq(jacobian[ok].reshape(-1, 5), e[ok].reshape(-1), rcond=None)[0]
        if again > 8 and not rounded:
            reach = min(_FAR_OFF, _TIGHTER * float(np.median(np.abs(e[ok]).max(axis=1))) + 1e-7)
    return _bounded(q, p, ticks, count) if rounded else p


def _bounded(q: F64, p: F64, ticks: int, count: float) -> F64:
    """Turn the parameters until few coordinates are beyond half a millimetre from the model."""
    best, best_share = p, -1.0
    scale = np.array([5e-5, 1e-3, 1e-3, 5e-5, 1e-3])  # angles count at 20 m
    for _ in range(40):
        e, jacobian = _residuals(q, p, ticks, count)
        beyond = np.sign(e) * np.maximum(np.abs(e) - _HALF, 0.0)
        active = (beyond != 0) & (np.abs(beyond) < 0.6 * _HALF)
        share = 1.0 - active.any(axis=1).mean()
        if share > best_share:
            best, best_share = p, share
        if not active.any():
            break
        a = jacobian[active] * scale
        normal = a.T @ a
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(5), a.T @ beyond[active])
        p = p + 0.7 * scale * step
    return best


def _start(q: F64, ticks: int, count: float) -> F64:
    """The cone from a line fit of z on rho, the rest from the phases of azimuth and range."""
    tick = 2 * np.pi / ticks
    rho = np.hypot(q[:, 0], q[:, 1])
    near = np.ones(len(q), bool)
    slope = offset = 0.0
    for _ in range(10):
        slope, offset = np.polyfit(rho[near], q[near, 2], 1)
        off = np.abs(q[:, 2] - slope * rho - offset)
        near = off < max(0.002, 2 * float(np.median(off)))
    theta = np.arctan(slope)
    far = rho > min(3.0, float(np.median(rho)))
    azimuth = np.arctan2(q[:, 1], q[:, 0])
    levers = np.arange(-0.06, 0.0601, 0.002)
    phases = np.array(
        [
            np.exp(1j * (azimuth - np.arcsin(np.clip(h / rho, -1, 1)))[far] * 2 * np.pi / tick).mean()
            for h in levers
        ]
    )
    sharpest = int(np.abs(phases).argmax())
    phi0 = np.angle(phases[sharpest]) / (2 * np.pi) * tick
    d = rho * np.cos(theta) + (q[:, 2] - offset) * np.sin(theta)
    d0 = np.angle(np.exp(2j * np.pi * d / count).mean()) / (2 * np.pi) * count
    return np.array([theta, offset, levers[sharpest], phi0, d0])


def _residuals(q: F64, p: F64, ticks: int, count: float) -> tuple[F64, F64]:
    """Residuals ``(N, 3)`` to the nearest lattice points and their Jacobian ``(N, 3, 5)``."""
    theta, z0, h, phi0, d0 = p
    tick = 2 * np.pi / ticks
    ct, st = np.cos(theta), np.sin(theta)
    rho = np.hypot(q[:, 0], q[:, 1])
    azimuth = np.arctan2(q[:, 1], q[:, 0]) - np.arcsin(np.clip(h / rho, -1, 1))
    phi = tick * np.rint((azimuth - phi0) / tick) + phi0
    d = count * np.rint((rho * ct + (q[:, 2] - z0) * st - d0) / count) + d0
    r = np.sqrt(np.maximum((d * ct) ** 2 - h * h, 0.0))
    c, s = np.cos(phi), np.sin(phi)
    model = np.stack([r * c - h * s, r * s + h * c, d * st + z0], axis=1)
    zero, one = np.zeros_like(d), np.ones_like(d)
    jacobian = np.stack(
        [
            np.stack([-d * st * c, zero, -s, -r * s - h * c, ct * c], axis=1),
            np.stack([-d * st * s, zero, c, r * c - h * s, ct * s], axis=1),
            np.stack([d * ct, one, zero, zero, st * one], axis=1),
        ],
        axis=1,
    )
    return q - model, jacobian
