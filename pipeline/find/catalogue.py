"""The catalogue of an output folder, ``OUT/catalogue.parquet``: one row a scan, to find scans by what is in them.

It is made of what runs have measured; nothing is decoded for it. What is not known of a scan is null.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic
from salpcc.schemas.labels import CLASSES, GROUND, GROUP_OF_CLASS, MOVABLE, OTHER
from salpcc.stages.evaluate.report.record import read_stamped

F64 = NDArray[np.float64]
VERSION = 1
_NONE: Mapping[tuple[str, str], F64] = MappingProxyType({})
_VERSION_KEY = b"salpcc.catalogue.version"
STREAMS = ("geometry", "intensity", "classes", "side")
# By column the class that it counts. Ground of no known kind is in the group's column.
CLASS_COLUMNS = {c.name.replace("-", "_"): i for i, c in enumerate(CLASSES) if c.name != "ground"}

CATALOGUE = pa.schema(
    [
        ("sequence", pa.string()),
        ("name", pa.string()),
        ("time", pa.uint64()),  # ns
        ("archive", pa.string()),  # below the output folder
        ("gop", pa.int32()),
        ("points", pa.int64()),  # of the source
        ("dropped", pa.int64()),  # points that can move and are not in the archive
        ("fallback", pa.int64()),  # points off the sensor's lattice
        ("static", pa.int64()),  # points by layer
        ("movable", pa.int64()),
        ("ground", pa.int64()),  # points by group
        ("other", pa.int64()),
        *((name, pa.int64()) for name in CLASS_COLUMNS),  # points by class
        ("speed", pa.float64()),  # m/s
        ("yaw_rate", pa.float64()),  # rad/s, to the left
        *(
            (name, pa.float64()) for name in ("x", "y", "z", "heading")
        ),  # m and rad, in the frame of the poses
        ("bytes", pa.int64()),
        *((f"bytes_{name}", pa.int64()) for name in STREAMS),
        ("bits", pa.float64()),  # per point of the source: far from its neighbours' it tells of a sick sensor
        *((f"bits_{name}", pa.float64()) for name in STREAMS),
        # Health of the sensor, by laser: returns, and bits a return of its range (null for a laser without returns). Null where
        # nothing tells which laser a point is of; bits, where points lie in the order of a list.
        ("laser_returns", pa.list_(pa.int32())),
        ("laser_bits", pa.list_(pa.float32())),
        ("silent_lasers", pa.int32()),  # lasers without returns
        # The most bits that a laser costs more than both beside it; well HDL-64E in streets stay below 0.7.
        ("laser_excess", pa.float64()),
        ("bit_exact", pa.bool_()),
        ("max_error_m", pa.float64()),
        ("decode_ms", pa.float64()),
        ("checksum", pa.string()),  # CRC-32 of the payload, of the static and of the movable layer
    ]
)


def catalogue_path(out: Path) -> Path:
    """Where the catalogue of an output folder lies."""
    return out / "catalogue.parquet"


def catalogue_of(metrics: pa.Table, poses: Mapping[tuple[str, str], F64] = _NONE) -> pa.Table:
    """Return the catalogue of the scans of a METRICS table (:mod:`salpcc.stages.evaluate.report.schema`).

    Args:
        poses: ``(4, 4)`` by sequence and name, as far as they are known.
    """
    points = metrics.column("points_in")
    sizes = {name: metrics.column(f"bytes_{name}") for name in STREAMS}
    columns: dict[str, Any] = {name: metrics.column(name) for name in metrics.column_names}
    columns["archive"] = pc.binary_join_element_wise("archives/", metrics.column("sequence"), ".mcap", "")
    columns |= {"points": points, "dropped": columns["points_dropped_movable"]}
    columns["fallback"] = columns["points_on_fallback"]
    columns |= _counts(metrics)
    columns |= _motion(metrics)
    columns |= _places(metrics, poses)
    columns |= _lasers(metrics)
    columns["bytes"] = sum_of(sizes.values())
    for name, size in {"bits": columns["bytes"], **{f"bits_{n}": s for n, s in sizes.items()}}.items():
        bits = pc.divide(pc.multiply(size.cast(pa.float64()), 8.0), points.cast(pa.float64()))
        columns[name] = pc.if_else(pc.greater(points, 0), bits, None)
    return pa.table([columns[name] for name in CATALOGUE.names], names=CATALOGUE.names).cast(CATALOGUE)


def sum_of(columns: Any) -> Any:
    """Add columns up, row by row."""
    first, *others = columns
    for other in others:
        first = pc.add(first, other)
    return first


def _counts(metrics: pa.Table) -> dict[str, pa.Array]:
    """Points by class and group, and by layer where there are two."""
    rows = [counts or [None] * len(CLASSES) for counts in metrics.column("class_counts").to_pylist()]
    by_class = pa.array(rows, pa.list_(pa.int64(), len(CLASSES))).flatten()
    counts = {
        c.name: by_class.take(pa.array(np.arange(len(rows)) * len(CLASSES) + i))
        for i, c in enumerate(CLASSES)
    }
    group = {
        number: sum_of(counts[CLASSES[i].name] for i in np.flatnonzero(number == GROUP_OF_CLASS))
        for number in (OTHER, GROUND, MOVABLE)
    }
    # The layer is what was taken for movable; where all is in one, the classes tell.
    movable = pc.coalesce(metrics.column("points_movable").combine_chunks(), group[MOVABLE])
    static = pc.subtract(metrics.column("points_in").combine_chunks(), movable)
    found = {column: counts[CLASSES[i].name] for column, i in CLASS_COLUMNS.items()}
    return {**found, "movable": movable, "static": static, "ground": group[GROUND], "other": group[OTHER]}


def _motion(metrics: pa.Table) -> dict[str, pa.Array]:
    """Speed and yaw rate from the motion during a turn, and from how long a turn of the sequence takes.

    The sensor turns against the azimuth by which the motion counts, hence the sign of the rate.
    """
    unknown = [np.nan] * 6
    motion = np.array([m or unknown for m in metrics.column("motion").to_pylist()]).reshape(-1, 6)
    turn = np.full(len(motion), np.nan)
    sequences = np.array(metrics.column("sequence").to_pylist(), object)
    names, times = metrics.column("name").to_pylist(), np.array(metrics.column("time"), np.int64)
    for sequence in set(sequences):
        rows = np.flatnonzero(sequences == sequence)
        turn[rows] = _turn([names[row] for row in rows], times[rows])
    with np.errstate(invalid="ignore", divide="ignore"):
        speed, yaw_rate = np.linalg.norm(motion[:, :3], axis=1) / turn, -motion[:, 5] / turn
    known = np.isfinite(speed)
    return {"speed": pa.array(speed, mask=~known), "yaw_rate": pa.array(yaw_rate, mask=~known)}


def _lasers(metrics: pa.Table) -> dict[str, pa.Array]:
    """Bits a return by laser, and what stands out; the first and the last laser have but one beside them."""
    rows: list[dict[str, Any]] = []
    for row in metrics.select(["laser_returns", "laser_bits"]).to_pylist():
        if row["laser_returns"] is None:
            rows.append({})
            continue
        returns = np.array(row["laser_returns"])
        rows.append({"laser_returns": row["laser_returns"], "silent_lasers": int((returns == 0).sum())})
        if row["laser_bits"] is None:
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            bits = np.where(returns > 0, np.array(row["laser_bits"]) / returns, np.nan)
            beside = np.fmax(np.append(np.nan, bits[:-1]), np.append(bits[1:], np.nan))
        excess = (bits - beside)[np.isfinite(bits - beside)]
        rows[-1]["laser_bits"] = [None if np.isnan(b) else float(b) for b in bits]
        rows[-1]["laser_excess"] = float(excess.max()) if len(excess) else None
    names = ("laser_returns", "laser_bits", "silent_lasers", "laser_excess")
    return {name: pa.array([row.get(name) for row in rows], CATALOGUE.field(name).type) for name in names}


def _places(metrics: pa.Table, poses: Mapping[tuple[str, str], F64]) -> dict[str, pa.Array]:
    """Where the sensor was, and the direction it faced: 0 along x, to the left from there."""
    scans = zip(*(metrics.column(key).to_pylist() for key in ("sequence", "name")), strict=True)
    found = [poses.get(scan) for scan in scans]
    at = [None if pose is None else (*pose[:3, 3], np.arctan2(pose[1, 0], pose[0, 0])) for pose in found]
    return {
        name: pa.array([row and float(row[place]) for row in at], pa.float64())
        for place, name in enumerate(("x", "y", "z", "heading"))
    }


def _turn(names: list[str], times: NDArray[np.int64]) -> float:
    """Seconds from a scan to the next; between frame numbers that have gaps, their share."""
    order = np.argsort(times, kind="stable")
    numbers = np.arange(len(names))
    if all(name.isascii() and name.isdigit() for name in names):
        numbers = np.array([int(names[row]) for row in order])
    steps, gaps = np.diff(numbers), np.diff(times[order]) / 1e9
    sound = (steps > 0) & (gaps > 0)
    return float(np.median(gaps[sound] / steps[sound])) if sound.any() else np.nan


def write_catalogue(rows: pa.Table, out: Path) -> None:
    """Write the catalogue of an output folder in place of the one that is there."""
    stamped = rows.replace_schema_metadata({_VERSION_KEY: str(VERSION).encode()})
    with atomic(catalogue_path(out)) as stream:
        pq.write_table(stamped, stream, compression="zstd")


def read_catalogue(out: Path) -> pa.Table:
    """Read the catalogue of an output folder.

    Raises:
        UsageError: there is none.
        ShardError: it is unreadable, or of a newer version.
    """
    path = catalogue_path(out)
    if not path.exists():
        raise UsageError(f"{path}: not there; `salpcc-pipeline run` leaves one in its --out")
    return read_stamped(path, _VERSION_KEY, VERSION)
