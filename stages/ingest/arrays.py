"""Make scans of arrays, with any further fields of their points."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import KindError, UsageError
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import message_to_scan

# Of sensor_msgs/PointField, by the type of an array.
_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_OWN = ("x", "y", "z", "intensity")


class Array(Protocol):
    """An array of NumPy, a tensor of PyTorch, or whatever else NumPy takes for one."""

    def __array__(self, dtype: Any = None, /) -> NDArray[Any]:
        """Return it as one of NumPy's."""
        ...


def scan_from_arrays(
    points: Any,
    intensity: Any = None,
    *,
    name: str = "000000",
    stamp: int = 0,
    frame_id: str = "velodyne",
    classes: Any = None,
    **fields: Any,
) -> Scan:
    """Return a scan of arrays: of NumPy, of PyTorch on any device, or whatever NumPy takes for one.

    Args:
        points: x, y, z in metres ``(N, 3)``, float32 or what float32 holds.
        intensity: ``(N,)`` alike; zeros where None.
        stamp: nanoseconds.
        classes: ``(N,)`` indices into :data:`salpcc.schemas.labels.CLASSES`.
        fields: any others by name, such as ``ring=`` and ``time=``, ``(N,)`` or ``(N, k)``; they come back as
            :attr:`Scan.fields <salpcc.schemas.scan.Scan.fields>` with their types, bit for bit.

    Raises:
        KindError: an array is of another shape or type; the message names it and the remedy. It is a TypeError, too.
        UsageError: a field has a name that it cannot have.

    >>> scan = scan_from_arrays(np.ones((2, 3)), ring=np.array([7, 8], np.uint8), name="000123")
    >>> scan.fields["ring"]
    array([7, 8], dtype=uint8)
    """
    where = f"scan {name!r}"
    xyz = points_array(points, where)
    bright = intensity_array(np.zeros(len(xyz)) if intensity is None else intensity, len(xyz), where)
    if not fields:
        return Scan(name, xyz, bright, stamp, frame_id, classes)
    columns: dict[str, NDArray[Any]] = dict(zip(_OWN, (*xyz.T, bright), strict=True))
    for key, values in fields.items():
        if key in _OWN:
            raise UsageError(f"{where}: {key} is a column of points or intensity already")
        if not key or not key.isprintable():  # lone surrogates, too
            raise UsageError(f"{where}: a field named {key!r}; a name is text that can be printed")
        columns[key] = _field(values, len(xyz), f"{where}: {key}")
    kind = np.dtype(
        [(key, column.dtype.newbyteorder("<"), column.shape[1:]) for key, column in columns.items()]
    )
    rows = np.empty(len(xyz), kind)
    for key, column in columns.items():
        rows[key] = column
    told, offset = [], 0
    for key, column in columns.items():
        count = int(np.prod(column.shape[1:]))
        told.append((key, offset, _DATATYPES[column.dtype.str[1:]], count))
        offset += count * column.dtype.itemsize
    message = CloudMessage(
        stamp, frame_id, len(rows), rows.tobytes(), point_step=kind.itemsize, fields=tuple(told)
    )
    scan = message_to_scan(LogMessage(1, stamp, stamp, 0, message.to_cdr()), "cdr", "", name)
    return Scan(name, scan.points, scan.intensity, stamp, frame_id, classes, cloud=scan.cloud)


def points_array(values: Any, where: str) -> NDArray[np.float32]:
    """Return points ``(N, 3)`` as float32.

    Raises:
        KindError: they are of another shape or type; the message begins with ``where``.
    """
    points = float32(values, f"{where}: points")
    if points.ndim != 2 or points.shape[1] != 3:
        more = "; give the fourth column as intensity" if points.ndim == 2 and points.shape[1] == 4 else ""
        raise KindError(f"{where}: points of shape {points.shape}; they are (N, 3), x, y, z in metres{more}")
    return points


def intensity_array(values: Any, n_points: int, where: str) -> NDArray[np.float32]:
    """Return intensities ``(N,)`` as float32.

    Raises:
        KindError: as in :func:`points_array`.
    """
    intensity = float32(values, f"{where}: intensity")
    if intensity.shape != (n_points,):
        raise KindError(f"{where}: intensity of shape {intensity.shape} for {n_points} points")
    return intensity


def array_of(values: Any, what: str) -> NDArray[Any]:
    """Return an array of what is one; tensors come from their device and leave their gradients behind.

    Raises:
        KindError: it is none, or holds what an array cannot; ``what`` it is is named.
    """
    if np.ma.is_masked(values):
        raise KindError(
            f"{what}: an array with masked values, and nothing holds the mask: .filled(numpy.nan), say, or give the mask as a field"
        )
    try:
        if hasattr(values, "detach"):
            values = values.detach().cpu()
        return np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise KindError(
            f"{what}: {type(values).__name__} is no array: {str(error).splitlines()[0]}"
        ) from error


def is_array(values: Any) -> bool:
    """Tell arrays and tensors from lists, scans and options."""
    return hasattr(values, "__array__") and not isinstance(values, np.generic)


def float32(values: Any, what: str) -> NDArray[np.float32]:
    """Return values as float32, where that changes none.

    Raises:
        KindError: it does, or they are no numbers; ``what`` they are is named.
    """
    array = array_of(values, what)
    if array.dtype.kind not in "fiu":
        raise KindError(f"{what} of type {array.dtype}; float32 is what is coded")
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = np.ascontiguousarray(array, np.float32)
        off = np.abs(narrow.astype(np.float64) - array)
        same = (narrow == array) | np.isnan(array)
        if array.dtype.kind in "iu":  # compared as float64, which does not hold the largest of 64 bits either
            same = (narrow < 2.0**63) & (narrow.astype(np.int64) == array)
    if not same.all():
        raise KindError(
            f"{what} of type {array.dtype} that float32 would change by up to {np.nanmax(off):.3g}; take an offset off "
            "them, or round them yourself: .astype(numpy.float32)"
        )
    return narrow


def _narrower(array: NDArray[Any]) -> str:
    """Say what makes a field of an array of another type, and loses nothing."""
    if array.dtype.kind not in "biu":
        return ".astype(numpy.float32), say"
    for name in ("uint8", "uint16", "int16", "uint32", "int32"):
        if array.size == 0 or (np.iinfo(name).min <= array.min() and array.max() <= np.iinfo(name).max):
            return f".astype(numpy.{name}), say"
    return ".view(numpy.uint32).reshape(len(…), -1) has all of its bits"


def _field(values: Any, n_points: int, what: str) -> NDArray[Any]:
    array = array_of(values, what)
    if array.ndim not in (1, 2) or len(array) != n_points or 0 in array.shape[1:]:
        raise KindError(f"{what} of shape {array.shape} for {n_points} points; it is (N,) or (N, k)")
    if array.dtype.str[1:] not in _DATATYPES:
        raise KindError(
            f"{what} of type {array.dtype}; a field is of 8 to 32 bits, or float64: {_narrower(array)}"
        )
    return array
