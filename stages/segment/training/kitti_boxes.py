"""KITTI's object and tracking benchmarks, read directly: 3-D boxes turned into SemanticKITTI labels.

Boxes are drawn in the left colour camera's view only, so the labels are partial: what is in view and in no box is known
not to move (99), what lies out of view, on a box's rim or where nobody cared to look stays unlabelled (0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import why
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.velodyne_bin import list_scans

F64 = NDArray[np.float64]

HINT = "KITTI's objects or tracking: ROOT/training/{velodyne,calib,label_2 or label_02}"
_IDS = {
    "Car": 10, "Van": 20, "Truck": 18, "Tram": 16, "Pedestrian": 30, "Person_sitting": 30, "Person": 30,
    "Cyclist": 31, "Misc": 0,
}  # fmt: skip
_IN_VIEW = 99
_RIM = 0.3  # metres around a box that may be its or not
_SOLE = 0.1  # metres; a box's lowest returns are the road's
_WIDE, _HIGH = 1224, 370  # pixels that every image of KITTI has


@dataclass(frozen=True)
class Box:
    """One line of a label file.

    Attributes:
        kind: KITTI's type, ``DontCare`` where only ``seen`` counts.
        track: number of the object in its file, from 1.
        seen: left, top, right, bottom in the image, pixels.
        size: height, width, length, metres.
        foot: centre of the bottom in the rectified camera's frame (right, down, ahead), metres.
        turn: angle about the camera's y, radians.
    """

    kind: str
    track: int
    seen: tuple[float, ...]
    size: tuple[float, ...]
    foot: tuple[float, ...]
    turn: float


def list_boxed(root: Path) -> list[ScanRef]:
    """List the scans of ``ROOT/training`` that have boxes; none where there is no such folder."""
    base = root / "training"
    refs = []
    for labels, folders in (
        ("label_2", [base / "velodyne"]),
        ("label_02", sorted((base / "velodyne").glob("*/"))),
    ):
        for folder in folders if (base / labels).is_dir() else []:
            for ref in list_scans(folder, None, folder, None):
                name = ref.name if labels == "label_2" else folder.name
                refs.append(replace(ref, labels=str(base / labels / f"{name}.txt")))
    return [ref for ref in refs if Path(ref.labels or "").is_file()]


def labels_of_boxes(ref: ScanRef, points: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return SemanticKITTI labels ``(N,)`` of points ``(N, 3)``: the class, and the instance in the upper 16 bits.

    Raises:
        SourceError: labels or calibration are missing or not KITTI's.
    """
    assert ref.labels is not None
    path = Path(ref.labels)
    calibration = read_calibration(path.parent.parent / "calib" / path.name)
    tracking = path.parent.name == "label_02"
    boxes = [box for frame, box in read_boxes(path, tracking) if not tracking or frame == ref.number]
    camera = points.astype(np.float64) @ calibration.to_camera[:3, :3].T + calibration.to_camera[:3, 3]
    pixel = camera @ calibration.projection[:, :3].T + calibration.projection[:, 3]
    with np.errstate(all="ignore"):
        across, down = pixel[:, 0] / pixel[:, 2], pixel[:, 1] / pixel[:, 2]
    labels = np.zeros(len(points), np.uint32)
    in_view = (pixel[:, 2] > 0) & (across >= 0) & (across < _WIDE) & (down >= 0) & (down < _HIGH)
    labels[in_view] = _IN_VIEW
    for box in boxes:
        if box.kind == "DontCare":
            left, top, right, bottom = box.seen
            labels[in_view & (across >= left) & (across <= right) & (down >= top) & (down <= bottom)] = 0
    named = [box for box in boxes if box.kind != "DontCare"]
    for box in named:
        labels[_within(box, camera, _RIM)] = 0
    for box in named:
        inside = _within(box, camera, 0.0)
        labels[inside] = _IDS[box.kind] and _IDS[box.kind] | box.track << 16
        labels[inside & (camera[:, 1] > box.foot[1] - _SOLE)] = 0
    return labels


def _within(box: Box, camera: F64, rim: float) -> NDArray[np.bool_]:
    """Tell which points ``(N, 3)`` in the camera's frame lie in a box that is wider by ``rim`` to all sides."""
    height, width, length = box.size
    right, down, ahead = (camera - box.foot).T
    c, s = np.cos(box.turn), np.sin(box.turn)
    return (
        (np.abs(c * right - s * ahead) <= length / 2 + rim)
        & (np.abs(s * right + c * ahead) <= width / 2 + rim)
        & (down <= rim)
        & (down >= -height - rim)
    )


@lru_cache(maxsize=64)
def read_boxes(path: Path, tracking: bool) -> tuple[tuple[int, Box], ...]:
    """Read the boxes of a label file, each with its frame (0 in a file of KITTI's objects).

    Raises:
        SourceError: unreadable, or a line is not a box.
    """
    return tuple(_parse(path, tracking))


def _parse(path: Path, tracking: bool) -> Iterator[tuple[int, Box]]:
    for at, line in enumerate(_lines(path), 1):
        words = line.split()
        try:
            frame, track = (int(words[0]), int(words[1]) + 1) if tracking else (0, at)
            kind, *rest = words[2:] if tracking else words
            values = [float(word) for word in rest[:14]]
            if len(values) != 14 or kind not in (*_IDS, "DontCare"):
                raise ValueError(line)
        except (ValueError, IndexError) as error:
            raise SourceError(f"{path}: line {at}, {line!r}, is not a box of KITTI's") from error
        seen, size, foot = (tuple(values[k : k + n]) for k, n in ((3, 4), (7, 3), (10, 3)))
        yield frame, Box(kind, track, seen, size, foot, values[13])


@dataclass(frozen=True, eq=False)
class Calibration:
    """``to_camera`` ``(4, 4)``: from the LiDAR into the rectified camera; ``projection`` ``(3, 4)``: on into its image."""

    to_camera: F64
    projection: F64


def read_calibration(path: Path) -> Calibration:
    """Read a calib file of KITTI's objects or tracking (which names the same matrices otherwise).

    Raises:
        SourceError: unreadable, or a matrix is missing.
    """
    rows: dict[str, list[str]] = {}
    for line in _lines(path):
        name, *values = line.replace(":", " ").split() or [""]
        rows[name] = values
    try:
        projection = np.array(rows["P2"], np.float64).reshape(3, 4)
        rectify, carry = np.eye(4), np.eye(4)
        rectify[:3, :3] = np.array(rows.get("R0_rect") or rows["R_rect"], np.float64).reshape(3, 3)
        carry[:3] = np.array(rows.get("Tr_velo_to_cam") or rows["Tr_velo_cam"], np.float64).reshape(3, 4)
    except (KeyError, ValueError) as error:
        raise SourceError(f"{path}: not a calibration of KITTI's objects or tracking ({error})") from error
    return Calibration(rectify @ carry, projection)


def _lines(path: Path) -> list[str]:
    try:
        return [line for line in path.read_text().splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        message = why(error) if isinstance(error, OSError) else "not text"
        raise SourceError(f"{path}: {message}") from error
