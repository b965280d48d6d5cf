"""Files of poses with times, as evo has them: TUM's and EuRoC's. Those of KITTI have none, see :mod:`.poses`."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.mapping.drive.trajectory import Trajectory

_TUM, _EUROC = (
    8,
    (8, 17),
)  # numbers a line: time, place, quaternion; EuRoC's ground truth has speeds and biases, too


def read_trajectory(path: Path) -> Trajectory | None:
    """Read a file of poses with times; None where it is none, such as KITTI's.

    TUM: ``time x y z qx qy qz qw``, seconds, parted by spaces. EuRoC: ``time,x,y,z,qw,qx,qy,qz``, nanoseconds. Lines that begin
    with ``#`` are remarks.

    Raises:
        SourceError: missing or unreadable; a line that is not as the first.
    """
    rows = [
        (at, line) for at, line in enumerate(frame_lines(path), start=1) if line and not line.startswith("#")
    ]
    if not rows:
        return None
    first = rows[0][1]
    commas = "," in first
    numbers = len(first.split("," if commas else None))
    if commas and numbers in _EUROC:
        return _read(path, rows, numbers, lambda line: line.split(","), 1, (5, 6, 7, 4))
    if not commas and numbers == _TUM:
        return _read(path, rows, numbers, str.split, 10**9, (4, 5, 6, 7))
    return None


def _read(
    path: Path,
    rows: list[tuple[int, str]],
    numbers: int,
    parts: Callable[[str], list[str]],
    unit: int,
    quaternion: tuple[int, ...],
) -> Trajectory:
    times, values = [], []
    for at, line in rows:
        fields = parts(line)
        if len(fields) != numbers:
            raise SourceError(
                f"{path}: line {at}: {len(fields)} numbers, the first one has {numbers}; mend it"
            )
        try:
            # As decimals: seconds since 1970 with nanoseconds are more digits than a float has.
            times.append(int((Decimal(fields[0]) * unit).to_integral_value()))
            values.append([float(value) for value in fields])
        except (ValueError, InvalidOperation, OverflowError) as error:
            raise SourceError(f"{path}: line {at}: not all of it are numbers; mend it") from error
    table = np.array(values)
    return Trajectory.of(str(path), times, table[:, 1:4], table[:, list(quaternion)])
