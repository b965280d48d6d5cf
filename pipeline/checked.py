"""Scans that somebody made of arrays: each is looked at before anything is written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import KindError, UsageError
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.arrays import array_of, intensity_array, points_array
from salpcc.stages.residual_code.archive.format import file_name

_LONGEST_NAME = 200  # bytes, as files have an ending besides


def checked(scans: Iterable[Scan], config: RunConfig) -> Iterator[Scan]:
    """Yield the scans with arrays of the types that they are coded as, copies, as whoever makes scans may fill the same arrays again.

    Raises:
        UsageError: one is no scan that could come back as it is; the message names it and the remedy.
    """
    seen: set[str] = set()
    labelled: bool | None = None
    for scan in scans:
        if not isinstance(scan, Scan):
            raise KindError(f"{type(scan).__name__} is no Scan; make one: Scan(name, points, intensity)")
        where = f"scan {scan.name!r}"
        labelled = scan.labels is not None if labelled is None else labelled
        check_name(scan.name, "scan")
        if scan.name in seen:
            raise UsageError(f"{where}: there is one of that name already")
        seen.add(scan.name)
        if not isinstance(scan.time, int | np.integer) or isinstance(scan.time, bool):
            raise UsageError(f"{where}: time {scan.time!r} is no whole number of nanoseconds")
        if not 0 <= scan.time < 1 << 63:
            raise UsageError(f"{where}: time {scan.time} is negative, or too large for 63 bits")
        if not isinstance(scan.frame_id, str):
            raise UsageError(f"{where}: frame_id {scan.frame_id!r} is no text")
        points = points_array(scan.points, where)
        intensity = intensity_array(scan.intensity, len(points), where)
        if scan.cloud is not None and len(scan.cloud.rest) != len(points):
            raise UsageError(f"{where}: a cloud of {len(scan.cloud.rest)} points for {len(points)}")
        yield replace(
            scan,
            points=points.copy(),
            intensity=intensity.copy(),
            time=int(scan.time),
            classes=_classes(scan.classes, len(points), where, config),
            labels=_labels(scan.labels, len(points), where, labelled) if config.stores_labels else None,
            cloud=scan.cloud and replace(scan.cloud, rest=scan.cloud.rest.copy()),
        )


def check_name(name: object, what: str) -> None:
    """Refuse what cannot name a file that is decoded to.

    Raises:
        UsageError: so it is.
    """
    try:
        length = len(file_name(name).encode())
    except ValueError as error:  # of a lone surrogate, too
        raise UsageError(f"{what} {name!r}: a name is text that a file can have, without slashes") from error
    if length > _LONGEST_NAME:
        raise UsageError(f"{what} {str(name)[:20]!r}…: a name has at most {_LONGEST_NAME} bytes")


def _labels(values: Any, n_points: int, where: str, wanted: bool) -> NDArray[np.uint32] | None:
    if (values is not None) != wanted:
        had = "have" if wanted else "have none"
        raise UsageError(f"{where}: labels {'missing' if wanted else 'given'}, and the scans before {had}")
    if values is None:
        return None
    array = array_of(values, f"{where}: labels")
    sound = array.shape == (n_points,) and array.dtype.kind in "iu"
    if not sound or (n_points and not 0 <= int(array.min()) <= int(array.max()) < 1 << 32):
        raise KindError(
            f"{where}: labels {array.dtype} of shape {array.shape}; they are whole numbers ({n_points},) of 32 bits"
        )
    return np.array(array, np.uint32)


def _classes(values: Any, n_points: int, where: str, config: RunConfig) -> NDArray[np.uint8] | None:
    if values is None:
        if config.labels == "given":
            raise UsageError(f"{where}: labels are given, but its classes are None")
        return None
    array = array_of(values, f"{where}: classes")
    if array.shape != (n_points,) or array.dtype.kind not in "iu":
        raise KindError(
            f"{where}: classes {array.dtype} of shape {array.shape}; they are whole numbers ({n_points},)"
        )
    if n_points and not 0 <= array.min() <= array.max() < len(CLASSES):
        raise UsageError(
            f"{where}: class {array.max()} is none of 0 to {len(CLASSES) - 1} (salpcc.schemas.labels.CLASSES)"
        )
    if config.labels != "given" and not config.uses_network:
        raise UsageError(f"{where}: it has classes, and the scans before have none")
    return np.array(array, np.uint8)
