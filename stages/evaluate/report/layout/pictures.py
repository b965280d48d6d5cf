"""Pictures of a decoded scan: as a range image and from above, coloured by class, height or error."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS

_BACKGROUND = (16, 19, 26)
_UNLABELLED = (122, 128, 140)  # black in the labels' own colours, which nobody would see here
_GROUP_COLOURS = np.array(
    [(196, 200, 208), (255, 105, 180), (70, 120, 255)], np.uint8
)  # other, ground, movable
_RANGE_ROWS, _RANGE_COLUMNS, _STRETCH = 64, 1024, 3
_SIDE, _REACH = 640, 48.0  # pixels, metres


@dataclass(frozen=True)
class Picture:
    """One picture: title, caption, the PNG as a data URI, and whether it takes the whole width."""

    title: str
    caption: str
    uri: str
    wide: bool


def scan_pictures(
    name: str, points: NDArray[np.float32], error: NDArray[np.float32], classes: NDArray[np.uint8] | None
) -> list[Picture]:
    """Draw a decoded scan ``(N, 3)`` with its errors ``(N,)`` in metres and classes ``(N,)`` or None."""
    finite = np.isfinite(points).all(axis=1)
    points, error = points[finite], error[finite]
    if not len(points):
        return []
    height, of_height = _scale(points[:, 2], -2.5, 3.0), "height, -2.5 m (dark) to 3 m (bright)"
    if classes is None:
        first, what = height, of_height
    else:
        colours = np.array([_UNLABELLED, *(c.colour for c in CLASSES[1:])], np.uint8)
        first = colours[classes[finite]]
        present = [CLASSES[i].name if i else "other (grey)" for i in np.unique(classes[finite])]
        what = "class: " + ", ".join(present)
    worst = float(np.max(error))
    second = _scale(error, 0.0, worst) if worst else height
    how = f"error, 0 (dark) to {1e3 * worst:.2f} mm (bright)" if worst else of_height + "; every error is 0"
    ways = [(first, what), (second, how)]
    if not worst and classes is None:  # one colouring says it all
        ways = [(height, how)]
    return [
        *(_from_the_side(name, f"Decoded, coloured by {text}.", points, colour) for colour, text in ways),
        *(_from_above(name, f"Coloured by {text}.", points, colour) for colour, text in ways),
    ]


def segmentation_pictures(
    name: str, points: NDArray[np.float32], truth: NDArray[np.uint8], predicted: NDArray[np.uint8]
) -> list[Picture]:
    """Draw a source scan ``(N, 3)``, the groups of its true classes ``(N,)``, and those of the predicted ones."""
    finite = np.isfinite(points).all(axis=1)
    points, truth, predicted = points[finite], truth[finite], predicted[finite]
    if not len(points):
        return []
    groups = [_GROUP_COLOURS[GROUP_OF_CLASS[classes]] for classes in (truth, predicted)]
    groups[0][truth == 0] = _UNLABELLED
    ways = [
        (_scale(points[:, 2], -2.5, 3.0), "Input, coloured by height."),
        (groups[0], "Truth."),
        (groups[1], "Result."),
    ]
    return [
        *(_from_the_side(name, text, points, colour) for colour, text in ways),
        *(_from_above(name, text, points, colour) for colour, text in ways[1:]),
    ]


def _from_the_side(
    name: str, caption: str, points: NDArray[np.float32], colours: NDArray[np.uint8]
) -> Picture:
    return Picture(f"{name}, range image", caption, _drawn(range_image(points, colours)), True)


def _from_above(name: str, caption: str, points: NDArray[np.float32], colours: NDArray[np.uint8]) -> Picture:
    return Picture(f"{name}, from above", caption, _drawn(birds_eye(points, colours)), False)


def range_image(points: NDArray[np.float32], colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Paint points ``(N, 3)`` in colours ``(N, 3)`` on an azimuth-elevation grid, nearest point in front."""
    x, y, z = points.astype(np.float64).T
    reach = np.sqrt(x * x + y * y + z * z)
    elevation = np.arctan2(z, np.hypot(x, y))
    low, high = np.percentile(elevation, [0.5, 99.9])
    row = np.clip((high - elevation) / max(high - low, 1e-6) * (_RANGE_ROWS - 1), 0, _RANGE_ROWS - 1)
    column = (np.pi - np.arctan2(y, x)) / (2 * np.pi) * _RANGE_COLUMNS
    image = np.empty((_RANGE_ROWS, _RANGE_COLUMNS, 3), np.uint8)
    image[:] = _BACKGROUND
    order = np.argsort(-reach, kind="stable")
    image[np.rint(row).astype(int)[order], column.astype(int)[order] % _RANGE_COLUMNS] = colours[order]
    return np.repeat(image, _STRETCH, axis=0)


def birds_eye(points: NDArray[np.float32], colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Paint points from above, driving direction up, the highest point in front."""
    near = (np.abs(points[:, :2]) <= _REACH).all(axis=1)  # others may be farther off than integers reach
    points, colours = points[near], colours[near]
    scale = _SIDE / (2 * _REACH)
    row = np.floor((_REACH - points[:, 0]) * scale).astype(int)
    column = np.floor((_REACH - points[:, 1]) * scale).astype(int)
    order = np.argsort(points[:, 2], kind="stable")
    order = order[((row >= 0) & (row < _SIDE) & (column >= 0) & (column < _SIDE))[order]]
    image = np.empty((_SIDE, _SIDE, 3), np.uint8)
    image[:] = _BACKGROUND
    image[row[order], column[order]] = colours[order]
    return image


def _scale(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    """Colours ``(N, 3)`` of values ``(N,)`` on a perceptually even scale that is never background."""
    part = np.clip((values.astype(np.float64) - low) / (high - low), 0.0, 1.0)
    colours = matplotlib.colormaps["viridis"](0.15 + 0.85 * part)
    return (255 * colours[:, :3]).astype(np.uint8)


def as_uri(png: bytes) -> str:
    """Write a PNG so that it can stand in a page."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _drawn(image: NDArray[np.uint8]) -> str:
    buffer = io.BytesIO()
    imsave(buffer, image, format="png")
    return as_uri(buffer.getvalue())
