"""Crops of labelled range images, and what turns one crop into another: rotation, mirror, scale, noise, gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.segment.network.range_image import HEIGHT, INTENSITY, RANGE, X, Y, Z
from salpcc.stages.segment.training.labelled import LabelledImage

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Crop:
    """A piece of a labelled image: ``planes`` ``(6, 64, w)``, ``classes`` ``(64, w)``; ``first`` is its first column."""

    planes: F32
    classes: NDArray[np.uint8]
    first: int


def cut(image: LabelledImage, first: int, width: int) -> Crop:
    """Cut ``width`` columns from ``first`` on, around the turn."""
    columns = np.arange(first, first + width) % image.classes.shape[1]
    return Crop(image.planes[:, :, columns], image.classes[:, columns], first)


def rotate(planes: F32, angle: float) -> None:
    """Turn x and y of planes ``(6, ...)`` about z, in place."""
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    x = planes[X] * c - planes[Y] * s
    planes[Y] = planes[X] * s + planes[Y] * c
    planes[X] = x


def azimuth_step(columns: int) -> float:
    """Angle in radians that one column to the right turns by."""
    return -2.0 * np.pi / columns


def mirror(crop: Crop, columns: int) -> Crop:
    """Swap left and right of the driving direction."""
    planes = np.ascontiguousarray(crop.planes[:, :, ::-1])
    planes[Y] *= -1
    first = (columns - crop.first - planes.shape[2]) % columns
    return Crop(planes, np.ascontiguousarray(crop.classes[:, ::-1]), first)


def distort(crop: Crop, rng: np.random.Generator, turned: float = 0.4, brightened: float = 0.25) -> Crop:
    """Turn, scale, brighten and thin out a crop at random; shares as in ``SampleConfig``."""
    planes = crop.planes.copy()
    # Mostly along the road or against it, where the heading tells something; at times any way at all.
    rotate(
        planes,
        rng.uniform(-np.pi, np.pi)
        if rng.random() < turned
        else rng.normal(0.0, 0.35) + np.pi * rng.integers(2),
    )
    planes[[X, Y, Z, RANGE, HEIGHT]] *= np.float32(rng.uniform(0.93, 1.07))
    lift = np.float32(rng.normal(0.0, 0.08))
    planes[Z] += lift
    noise = rng.normal(0.0, rng.uniform(0.0, 0.015), planes[RANGE].shape).astype(np.float32)
    stretch = 1.0 + noise / np.maximum(planes[RANGE], 1.0)
    planes[[X, Y, Z, RANGE]] *= stretch
    planes[HEIGHT] += rng.normal(0.0, 0.04)
    wide = rng.random() < brightened  # another sensor's calibration
    power, gain = (
        (rng.uniform(0.5, 2.0), rng.uniform(0.5, 1.5))
        if wide
        else (rng.uniform(0.8, 1.25), rng.uniform(0.8, 1.2))
    )
    bright = planes[INTENSITY] ** power * gain
    planes[INTENSITY] = bright + rng.normal(0.0, 0.02, bright.shape)
    planes[INTENSITY] = planes[INTENSITY].clip(0.0, 1.0)

    gone = rng.random(planes[RANGE].shape) < rng.choice([0.0, 0.02, 0.1, 0.25], p=[0.5, 0.2, 0.2, 0.1])
    if rng.random() < 0.15:  # a dead or dirty laser
        gone[rng.integers(0, len(gone), rng.integers(1, 5))] = True
    gone |= planes[RANGE] <= 0
    planes[:, gone] = 0.0
    classes = crop.classes.copy()
    classes[gone] = 0
    return replace(crop, planes=planes, classes=classes)
