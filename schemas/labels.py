"""Label classes: the 19 of SemanticKITTI, and the three groups of the paper (section V)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OTHER, GROUND, MOVABLE = 0, 1, 2
GROUPS = ("other", "ground", "movable")


class LabelClass(NamedTuple):
    """One class: its name, its group, its colour, and the SemanticKITTI label ids it gathers."""

    name: str
    group: int
    colour: tuple[int, int, int]
    ids: tuple[int, ...]


# Index = the value stored in shards and archives. 0 to 19 are SemanticKITTI's training classes, 20
# is for a segmenter that knows groups only. Terrain (72) is not ground: the paper's group lacks it.
CLASSES: tuple[LabelClass, ...] = (
    LabelClass("unlabelled", OTHER, (0, 0, 0), (0, 1, 52, 99)),
    LabelClass("car", MOVABLE, (100, 150, 245), (10, 252)),
    LabelClass("bicycle", MOVABLE, (100, 230, 245), (11,)),
    LabelClass("motorcycle", MOVABLE, (30, 60, 150), (15,)),
    LabelClass("truck", MOVABLE, (80, 30, 180), (18, 258)),
    LabelClass("other-vehicle", MOVABLE, (0, 0, 255), (13, 16, 20, 256, 257, 259)),
    LabelClass("person", MOVABLE, (255, 30, 30), (30, 254)),
    LabelClass("bicyclist", MOVABLE, (255, 40, 200), (31, 253)),
    LabelClass("motorcyclist", MOVABLE, (150, 30, 90), (32, 255)),
    LabelClass("road", GROUND, (255, 0, 255), (40, 60)),
    LabelClass("parking", GROUND, (255, 150, 255), (44,)),
    LabelClass("sidewalk", GROUND, (75, 0, 75), (48,)),
    LabelClass("other-ground", GROUND, (175, 0, 75), (49,)),
    LabelClass("building", OTHER, (255, 200, 0), (50,)),
    LabelClass("fence", OTHER, (255, 120, 50), (51,)),
    LabelClass("vegetation", OTHER, (0, 175, 0), (70,)),
    LabelClass("trunk", OTHER, (135, 60, 0), (71,)),
    LabelClass("terrain", OTHER, (150, 240, 80), (72,)),
    LabelClass("pole", OTHER, (255, 240, 150), (80,)),
    LabelClass("traffic-sign", OTHER, (255, 0, 0), (81,)),
    LabelClass("ground", GROUND, (200, 120, 200), ()),
)

GROUP_OF_CLASS: NDArray[np.uint8] = np.array([c.group for c in CLASSES], np.uint8)

# Of the LAS specification: 2 ground, 5 high vegetation, 6 building; 1 is unclassified.
ASPRS_OF_CLASS: NDArray[np.uint8] = np.array(
    [
        2 if c.group == GROUND else {"vegetation": 5, "trunk": 5, "building": 6}.get(c.name, 1)
        for c in CLASSES
    ],
    np.uint8,
)

_UNKNOWN = 255
_CLASS_OF_ID: NDArray[np.uint8] = np.full(1 << 16, _UNKNOWN, np.uint8)
for _index, _class in enumerate(CLASSES):
    _CLASS_OF_ID[list(_class.ids)] = _index


def classes_of_labels(labels: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Map raw SemanticKITTI labels ``(N,)`` (lower 16 bits are the id) to class indices.

    Raises:
        ValueError: a label id is not one of SemanticKITTI's.
    """
    ids = labels & 0xFFFF
    classes: NDArray[np.uint8] = _CLASS_OF_ID[ids]
    if (classes == _UNKNOWN).any():
        unknown = int(ids[classes == _UNKNOWN][0])
        raise ValueError(f"label id {unknown} is not a SemanticKITTI class")
    return classes


def known_classes(labels: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Map raw labels ``(N,)`` of any origin to class indices, 255 where the id is none of SemanticKITTI's."""
    return np.asarray(_CLASS_OF_ID[labels & 0xFFFF])


def labels_of_classes(classes: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Map class indices to raw SemanticKITTI labels; inverse of :func:`classes_of_labels`.

    Of several labels of a class it takes the first. Ground of no known kind, which has no label, becomes other-ground.
    """
    other_ground = next(c.ids[0] for c in CLASSES if c.name == "other-ground")
    return np.array([c.ids[0] if c.ids else other_ground for c in CLASSES], np.uint32)[classes]
