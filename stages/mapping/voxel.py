"""Fuse points by voxel: mean place and intensity, how many points, in how many scans, the commonest class.

Movable points never share a voxel's entry with others, so that they can be taken out, marked and counted.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE

F64 = NDArray[np.float64]

SYNTHETIC = 255  # class of what nobody measured: ground filled in from a plane
# Voxel numbers per axis in a key: at 0.1 m, 419 km to and fro and 26 km up.
_BITS_XY, _BITS_Z = 22, 18


@dataclass(frozen=True, eq=False)
class Voxels:
    """Entries of a voxel map, one row each.

    Attributes:
        xyz: mean place ``(M, 3)`` float64, metres.
        intensity: mean ``(M,)`` float32.
        classes: ``(M,)`` uint8 index into :data:`salpcc.schemas.labels.CLASSES`, or SYNTHETIC.
        count: points ``(M,)`` uint32.
        scans: scans that met it ``(M,)`` uint16.
    """

    xyz: F64
    intensity: NDArray[np.float32]
    classes: NDArray[np.uint8]
    count: NDArray[np.uint32]
    scans: NDArray[np.uint16]

    def __len__(self) -> int:
        """Number of entries."""
        return len(self.xyz)

    def __getitem__(self, which: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Voxels:
        """Pick entries."""
        return Voxels(*(getattr(self, field.name)[which] for field in fields(self)))

    @property
    def kind(self) -> int:
        """The class that most entries are of, as :attr:`classes`; there is at least one."""
        return int(np.bincount(self.classes).argmax())

    @classmethod
    def of_points(cls, xyz: F64, intensity: NDArray[np.float32], classes: NDArray[np.uint8] | None) -> Voxels:
        """Take the points of one scan, not fused yet. Without classes all are unlabelled."""
        n = len(xyz)
        ones = np.ones(n, np.uint32)
        known = np.zeros(n, np.uint8) if classes is None else classes
        return cls(xyz, intensity, known, ones, ones.astype(np.uint16))

    @classmethod
    def together(cls, parts: list[Self]) -> Voxels:
        """Put entries one after the other, not fused yet; none give an empty map."""
        if not parts:
            return cls.of_points(np.empty((0, 3)), np.empty(0, np.float32), None)
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    @property
    def movable(self) -> NDArray[np.bool_]:
        """Mark the entries of movable things ``(M,)``."""
        return np.asarray(_MOVABLE[self.classes])


_MOVABLE = np.zeros(256, np.bool_)
_MOVABLE[: len(GROUP_OF_CLASS)] = GROUP_OF_CLASS == MOVABLE


def keys_of(xyz: F64, size: float) -> NDArray[np.int64]:
    """Return the voxel of each point ``(N, 3)`` as one number; neighbours in z differ by 1.

    Raises:
        SourceError: some lie so far out that their number would be another voxel's.
    """
    at = np.floor(xyz * (1.0 / size)).astype(np.int64)
    if len(at):
        reach = np.maximum(at.max(axis=0), -1 - at.min(axis=0))
        if reach[:2].max() >= 1 << (_BITS_XY - 1) or reach[2] >= 1 << (_BITS_Z - 1):
            raise SourceError(
                f"points {size * reach[:2].max() / 1000:.0f} km away and {size * reach[2]:.0f} m high; voxels of {size:g} m "
                f"reach {size * (1 << (_BITS_XY - 1)) / 1000:.0f} km and {size * (1 << (_BITS_Z - 1)):.0f} m from the "
                "first pose: are these poses in metres? else choose a larger --voxel"
            )
    at[:, :2] += 1 << (_BITS_XY - 1)
    at[:, 2] += 1 << (_BITS_Z - 1)
    return np.asarray((at[:, 0] << (_BITS_XY + _BITS_Z)) | (at[:, 1] << _BITS_Z) | at[:, 2])


def neighbours_of() -> list[int]:
    """Return by how much the keys of 13 of a voxel's 26 neighbours differ from its own; the others are the same, negative."""
    steps = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    return [(x << (_BITS_XY + _BITS_Z)) + (y << _BITS_Z) + z for x, y, z in steps if (x, y, z) > (0, 0, 0)]


def coarser(keys: NDArray[np.int64], factor: int) -> NDArray[np.int64]:
    """Return keys of voxels ``factor`` times as wide."""
    low = (1 << _BITS_XY) - 1
    x, y, z = keys >> (_BITS_XY + _BITS_Z), (keys >> _BITS_Z) & low, keys & ((1 << _BITS_Z) - 1)
    half_xy, half_z = 1 << (_BITS_XY - 1), 1 << (_BITS_Z - 1)
    x, y = (x - half_xy) // factor + half_xy, (y - half_xy) // factor + half_xy
    z = (z - half_z) // factor + half_z
    return np.asarray((x << (_BITS_XY + _BITS_Z)) | (y << _BITS_Z) | z)


def fuse(voxels: Voxels, size: float) -> Voxels:
    """Fuse entries that fall into the same voxel of ``size`` metres, movable ones apart; ordered by key.

    Entries of one scan must be fused on their own before several scans are, so that ``scans`` counts scans.
    """
    if not len(voxels):
        return voxels
    key = keys_of(voxels.xyz, size) * 2 + voxels.movable
    order = np.argsort(key)
    new = np.concatenate([[True], np.diff(key[order]) != 0])
    return Voxels(*_fold(order, new, *(getattr(voxels, field.name) for field in fields(voxels))))


def fuse_scan(
    xyz: F64, intensity: NDArray[np.float32], classes: NDArray[np.uint8] | None, size: float
) -> Voxels:
    """Fuse the points of one scan: every entry is met by one scan."""
    fused = fuse(Voxels.of_points(xyz, intensity, classes), size)
    return Voxels(fused.xyz, fused.intensity, fused.classes, fused.count, np.ones(len(fused), np.uint16))


@njit(cache=True)
def _fold(
    order: NDArray[np.intp],
    new: NDArray[np.bool_],
    xyz: F64,
    intensity: NDArray[np.float32],
    classes: NDArray[np.uint8],
    count: NDArray[np.uint32],
    scans: NDArray[np.uint16],
) -> tuple[F64, NDArray[np.float32], NDArray[np.uint8], NDArray[np.uint32], NDArray[np.uint16]]:
    """Walk the entries in order; a new voxel begins where ``new`` says so. Means are weighted by points."""
    groups = new.sum()
    out_xyz = np.zeros((groups, 3))
    out_intensity = np.zeros(groups, np.float32)
    out_classes = np.zeros(groups, np.uint8)
    out_count = np.zeros(groups, np.uint32)
    out_scans = np.zeros(groups, np.uint16)
    g = -1
    lead = np.int64(0)  # Boyer and Moore's vote for the commonest class
    bright = 0.0
    for i in range(len(order)):
        j = order[i]
        if new[i]:
            g += 1
            lead = np.int64(0)
            bright = 0.0
        n = np.int64(count[j])
        for axis in range(3):
            out_xyz[g, axis] += n * xyz[j, axis]
        bright += n * np.float64(intensity[j])
        if lead == 0:
            out_classes[g] = classes[j]
        lead = lead + n if out_classes[g] == classes[j] else lead - n
        if lead < 0:
            out_classes[g] = classes[j]
            lead = -lead
        out_count[g] += np.uint32(n)
        met = np.int64(out_scans[g]) + np.int64(scans[j])
        out_scans[g] = np.uint16(met) if met < 65535 else np.uint16(65535)
        if i + 1 == len(order) or new[i + 1]:
            total = np.float64(out_count[g])
            for axis in range(3):
                out_xyz[g, axis] /= total
            out_intensity[g] = np.float32(bright / total)
    return out_xyz, out_intensity, out_classes, out_count, out_scans
