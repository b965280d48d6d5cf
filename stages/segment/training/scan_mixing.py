"""Scenes that nobody drove through: LaserMix, FrustumMix and pasted vehicles and people.

Fifty scans hold some hundred vehicles; set before other walls and streets they go a long way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES, GROUND, GROUP_OF_CLASS
from salpcc.stages.segment.network.range_image import HEIGHT, RANGE, Y, Z
from salpcc.stages.segment.training.crops import Crop, azimuth_step, rotate
from salpcc.stages.segment.training.labelled import NOT_MOVABLE, LabelledImage

F32 = NDArray[np.float32]

_LEAST_PIXELS = 20
_TERRAIN = next(i for i, c in enumerate(CLASSES) if c.name == "terrain")
_STANDS_ON = np.append((GROUP_OF_CLASS == GROUND) | (np.arange(len(CLASSES)) == _TERRAIN), False)
_LOW = 0.2  # metres above the lowest returns around: ground where there is no label


@dataclass(frozen=True, eq=False)
class Instance:
    """One object cut out: ``planes`` ``(6, 64, w)``, ``mask`` ``(64, w)``, its class, its first column."""

    planes: F32
    mask: NDArray[np.bool_]
    label: int
    first: int


def instances_of(image: LabelledImage) -> list[Instance]:
    """Cut out the objects of an image (those with a name of their own) that show at least 20 pixels."""
    found = []
    columns = image.classes.shape[1]
    names, counts = np.unique(image.instances[image.instances > 0], return_counts=True)
    for name in names[counts >= _LEAST_PIXELS]:
        mask = image.instances == name
        used = np.flatnonzero(mask.any(axis=0))
        gaps = np.diff(np.append(used, used[0] + columns))
        first = int(
            used[(np.argmax(gaps) + 1) % len(used)]
        )  # after the widest gap: objects may lie on the seam
        width = columns - int(gaps.max()) + 1
        if width > columns // 4:
            continue
        around = np.arange(first, first + width) % columns
        label = int(np.bincount(image.classes[mask]).argmax())
        found.append(Instance(image.planes[:, :, around], mask[:, around], label, first))
    return found


def paste(crop: Crop, instance: Instance, column: int, columns: int, flip: bool) -> bool:
    """Set an instance into a crop at a column, in place, where it would stand on ground; tell whether it did.

    It keeps its range, so that lasers and density stay true; what it hides vanishes behind it.
    """
    planes, mask = instance.planes, instance.mask
    if flip:
        planes, mask = planes[:, :, ::-1].copy(), mask[:, ::-1]
        planes[Y] *= -1
        first = columns - instance.first - mask.shape[1]
    else:
        planes, first = planes.copy(), instance.first
    width = mask.shape[1]
    if column + width > crop.classes.shape[1]:
        return False
    rotate(planes, (crop.first + column - first) * azimuth_step(columns))

    target = crop.planes[:, :, column : column + width]
    classes = crop.classes[:, column : column + width]
    rows = np.flatnonzero(mask.any(axis=1))
    foot = slice(max(rows[-1] - 1, 0), rows[-1] + 3)
    unnamed = (classes[foot] == 0) | (classes[foot] == NOT_MOVABLE)
    stands = _STANDS_ON[classes[foot]] | (unnamed & (target[HEIGHT, foot] < _LOW))
    below = (target[RANGE, foot] > 0) & stands
    if below.mean() < 0.5:
        return False
    standing = planes[RANGE][rows[-1]][mask[rows[-1]]].mean()
    ground = target[RANGE, foot][below].mean()
    lift = target[Z, foot][below].mean() - planes[Z][rows[-1]][mask[rows[-1]]].mean()
    if abs(ground - standing) > 0.12 * standing + 0.7 or abs(lift) > 0.5:
        return False
    shows = mask & ((target[RANGE] == 0) | (planes[RANGE] < target[RANGE]))
    planes[Z] += np.float32(lift)
    target[:, shows] = planes[:, shows]
    classes[shows] = instance.label
    return True


def mix(crop: Crop, other: Crop, columns: int, rng: np.random.Generator) -> Crop:
    """Take bands of lasers (LaserMix) or of azimuth (FrustumMix) from another crop of the same size."""
    planes, classes = crop.planes.copy(), crop.classes.copy()
    turned = other.planes.copy()
    rotate(turned, (crop.first - other.first) * azimuth_step(columns))
    height, width = classes.shape
    if rng.random() < 0.5:
        cuts = np.sort(rng.integers(0, height, rng.integers(1, 5)))
        taken = np.broadcast_to(
            (np.searchsorted(cuts, np.arange(height), "right") % 2 == 1)[:, None], classes.shape
        )
    else:
        a, b = np.sort(rng.integers(0, width, 2))
        taken = np.broadcast_to((np.arange(width) >= a) & (np.arange(width) < b), classes.shape)
    planes[:, taken] = turned[:, taken]
    classes[taken] = other.classes[taken]
    return Crop(planes, classes, crop.first)
