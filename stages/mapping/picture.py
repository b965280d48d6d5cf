"""Draw a map, as the paper's Fig. 10 does: from above and in perspective, movable things in red."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.ft2font import FT2Font
from numpy.typing import NDArray
from PIL import Image

from salpcc.stages.mapping.build import CARVED, DROPPED, OBJECT
from salpcc.stages.mapping.voxel import SYNTHETIC, Voxels

F64 = NDArray[np.float64]
Index = NDArray[np.uint8]

WIDTH, HEIGHT = 960, 600  # pixels
_PER_PIXEL = 0.125  # metres, from above
_LEVELS = 40  # colours for height, 1 to _LEVELS; 0 is the background
_LOW, _HIGH = -2.0, 7.0  # metres above the sensor's way, of the first and last colour
_RED, _ORANGE, _BLUE, _GREEN = _LEVELS + 1, _LEVELS + 2, _LEVELS + 3, _LEVELS + 4
_GREY, _WHITE = _LEVELS + 5, 255
_NUMBERED = 30  # objects at most that have their number on a picture
_POINTS = 11.0  # of what is written
_MARGIN = 12  # pixels around what is written on a picture
_BARS = tuple(digit * 10**power for power in range(6) for digit in (1, 2, 5))  # metres
_REMOVED = {_RED: "of a movable class, or among it", _ORANGE: "seen through"}
_BEHIND, _ABOVE, _DOWN = 30.0, 20.0, np.radians(27.0)  # the eye: metres from the sensor, and its tilt
_FOCAL = 0.9 * WIDTH


@dataclass(frozen=True)
class Place:
    """Where one looks from: a sensor pose whose heading points right from above, and ahead in perspective."""

    pose: F64

    def local(self, xyz: F64) -> F64:
        """Take places ``(N, 3)`` to x ahead, y left, z up, level."""
        ahead = self.pose[:2, 0] / np.linalg.norm(self.pose[:2, 0])
        off = xyz - self.pose[:3, 3]
        return np.column_stack(
            [
                off[:, 0] * ahead[0] + off[:, 1] * ahead[1],
                off[:, 1] * ahead[0] - off[:, 0] * ahead[1],
                off[:, 2],
            ]
        )


def busiest(poses: F64, xyz: F64, against: NDArray[np.uint8]) -> Place:
    """Choose the pose, of ``(n, 4, 4)``, around which most was taken out."""
    gone = xyz[against != 0]
    few = poses[:: max(1, len(poses) // 100)]
    counts = [np.count_nonzero(np.square(gone[:, :2] - p[:2, 3]).sum(axis=1) < 30.0**2) for p in few]
    return Place(few[int(np.argmax(counts))] if len(gone) else poses[len(poses) // 2])


def pictures(voxels: Voxels, against: NDArray[np.uint8], place: Place) -> dict[str, bytes]:
    """Draw four PNGs, by name: from above and in perspective, before (all, what goes marked) and after."""
    local = place.local(voxels.xyz)
    colour = _height_colour(local[:, 2])
    colour[voxels.classes == SYNTHETIC] = _BLUE
    marked = colour.copy()
    marked[against & CARVED != 0] = _ORANGE
    marked[against & (DROPPED | OBJECT) != 0] = _RED
    measured, kept = voxels.count > 0, against == 0
    out = {}
    for name, draw, scale in (("above", _above, _PER_PIXEL), ("perspective", _perspective, None)):
        out[f"{name}_before"] = _png(draw(local[measured], marked[measured]), scale, _REMOVED)
        out[f"{name}_after"] = _png(
            draw(local[kept], colour[kept]), scale, {_BLUE: "filled in"} if _BLUE in colour else {}
        )
    return out


def removed_picture(voxels: Voxels, against: NDArray[np.uint8], objects: NDArray[np.uint32]) -> bytes:
    """Draw a PNG of what was removed, from above, x to the right: orange what was seen through, red what its class told.

    The largest objects ``(M,)``, which are numbered by size, have their numbers beside them.
    """
    colour = np.where(against & CARVED, _ORANGE, _RED).astype(np.uint8)
    middle = np.median(voxels.xyz, axis=0) if len(voxels) else np.zeros(3)
    notes = []
    for number in np.unique(objects)[:_NUMBERED]:
        x, y = np.median(voxels.xyz[objects == number, :2], axis=0) - middle[:2]
        notes.append((x / _PER_PIXEL + WIDTH / 2, HEIGHT / 2 - y / _PER_PIXEL, str(number)))
    return _png(_above(voxels.xyz - middle, colour), _PER_PIXEL, _REMOVED, notes)


def difference_picture(xyz: F64, state: NDArray[np.uint8]) -> bytes:
    """Draw a PNG of what differs between two maps, from above, x to the right, all of it: state 0 is in both, 1 gone, 2 appeared, 3 moved."""
    low, high = (xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)) if len(xyz) else (np.zeros(2), np.ones(2))
    scale = max(_PER_PIXEL, *((high - low) / (WIDTH, HEIGHT)))
    colour = np.array([_GREY, _RED, _GREEN, _BLUE], np.uint8)[state]
    middle = np.append((low + high) / 2, 0.0)
    legend = {_GREY: "in both", _RED: "gone", _GREEN: "appeared", _BLUE: "moved"}
    return _png(_above(xyz - middle, colour, scale), scale, legend)


def _above(local: F64, colour: Index, scale: float = _PER_PIXEL) -> Index:
    """Paint from above, driving direction to the right, ``scale`` metres a pixel, the highest in front; marks go over all."""
    column = np.floor(local[:, 0] / scale + WIDTH / 2).astype(np.int64)
    row = np.floor(HEIGHT / 2 - local[:, 1] / scale).astype(np.int64)
    order = np.lexsort((local[:, 2], (colour > _LEVELS) & (colour != _GREY)))
    return _paint(row, column, colour, order, np.zeros(len(local), np.int64))


def _perspective(local: F64, colour: Index) -> Index:
    """Paint as seen from behind and above, the nearest in front; near points are wider."""
    ahead, up = local[:, 0] + _BEHIND, local[:, 2] - _ABOVE
    depth = ahead * np.cos(_DOWN) - up * np.sin(_DOWN)
    rise = ahead * np.sin(_DOWN) + up * np.cos(_DOWN)
    seen = depth > 3.0
    depth, colour = depth[seen], colour[seen]
    column = np.floor(WIDTH / 2 - _FOCAL * local[seen, 1] / depth).astype(np.int64)
    row = np.floor(HEIGHT / 2 - _FOCAL * rise[seen] / depth).astype(np.int64)
    return _paint(row, column, colour, np.argsort(-depth), (0.09 * _FOCAL / depth).astype(np.int64))


def _paint(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    colour: Index,
    order: NDArray[np.intp],
    wider: NDArray[np.int64],
) -> Index:
    """Paint points in order, each ``wider + 1`` pixels wide and high, three at most."""
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    size = np.minimum(wider, 2)
    spots = np.concatenate([np.column_stack([order, np.full(len(order), k)]) for k in range(9)])
    i, k = spots[np.argsort(np.tile(np.arange(len(order)), 9), kind="stable")].T
    keep = (k // 3 <= size[i]) & (k % 3 <= size[i])
    i, k = i[keep], k[keep]
    r, c = row[i] + k // 3, column[i] + k % 3
    inside = (r >= 0) & (r < HEIGHT) & (c >= 0) & (c < WIDTH)
    image[r[inside], c[inside]] = colour[i[inside]]
    return image


def _height_colour(z: F64) -> Index:
    part = np.clip((z - _LOW) / (_HIGH - _LOW), 0.0, 1.0)
    return (1 + np.floor(part * (_LEVELS - 1))).astype(np.uint8)


def _png(
    image: Index, metres: float | None, legend: dict[int, str], notes: Sequence[tuple[float, float, str]] = ()
) -> bytes:
    """Colour an image, with a legend of some colours, and a bar of a round length where all pixels are as many ``metres``.

    ``notes`` are texts at a column and a row.
    """
    scale = matplotlib.colormaps["viridis"](np.linspace(0.12, 1.0, _LEVELS))[:, :3]
    table = np.zeros((256, 3), np.uint8)
    table[0] = (16, 19, 26)
    table[1 : _LEVELS + 1] = np.round(255 * scale)
    table[_RED], table[_ORANGE], table[_BLUE] = (235, 40, 45), (255, 150, 40), (90, 170, 255)
    table[_GREEN], table[_GREY], table[_WHITE] = (60, 210, 90), (95, 100, 110), (255, 255, 255)
    image, at = image.copy(), WIDTH
    for of, text in reversed(legend.items()):  # from the right upper corner to the left
        at -= 14 + _lettering(text).shape[1] + _MARGIN
        image[_MARGIN : _MARGIN + 10, at : at + 10] = of
        _write(image, at + 14, _MARGIN - 1, text)
    for column, row, text in notes:
        _write(image, round(column), round(row), text)
    if metres is not None:
        length = next(n for n in _BARS if n / metres > WIDTH / 12)
        y, x = HEIGHT - _MARGIN, WIDTH - _MARGIN
        image[y - 3 : y + 1, x - round(length / metres) : x + 1] = _WHITE
        _write(image, x - round(length / metres), y - 18, f"{length} m")
    picture = Image.fromarray(image, "P")
    picture.putpalette(table.ravel().tolist())
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _write(image: Index, column: int, row: int, text: str) -> None:
    """Write a text in white, its upper left corner at a column and a row; what lies outside is left out."""
    r, c = np.nonzero(_lettering(text))
    r, c = r + row, c + column
    inside = (r >= 0) & (r < HEIGHT) & (c >= 0) & (c < WIDTH)
    image[r[inside], c[inside]] = _WHITE


@cache
def _lettering(text: str) -> NDArray[np.bool_]:
    """The pixels of a text, ``(height, width)``, in matplotlib's own font: Pillow's would load a library of the system."""
    font = FT2Font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")))
    font.set_size(_POINTS, 72)
    font.set_text(text)
    font.draw_glyphs_to_bitmap(antialiased=False)
    return np.asarray(font.get_image()) > 0
