"""The poses that an archive holds in its side files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.stages.mapping.drive.poses import read_poses
from salpcc.stages.residual_code.archive.format import frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader

_FILES = ("poses.txt", "calib.txt")


@contextmanager
def unpacked_poses(reader: ArchiveReader) -> Iterator[Path | None]:
    """Lay poses.txt, with calib.txt beside it, in a folder for a while; None where the archive lacks one of them.

    Raises:
        ArchiveError: a side file is damaged.
    """
    if not set(_FILES) <= set(reader.side):
        yield None
        return
    with TemporaryDirectory() as folder:
        for name in _FILES:
            (Path(folder) / name).write_bytes(reader.side_file(name).data)
        yield Path(folder) / _FILES[0]


def held_poses(reader: ArchiveReader) -> dict[str, NDArray[np.float64]]:
    """Return the sensor's pose ``(4, 4)`` by the name of its scan, x ahead, y left, z up in the first frame of the file.

    Scans without one are left out; all of them, where the archive has no poses of KITTI's kind with their calibration.

    Raises:
        ArchiveError: a side file is damaged.
    """
    with unpacked_poses(reader) as path:
        try:
            poses = None if path is None else read_poses(path)
        except SourceError:  # such as of another kind
            poses = None
    if poses is None:
        return {}
    numbers = {name: frame_number(name, place) for place, name in enumerate(reader.names)}
    return {name: poses[n] for name, n in numbers.items() if n < len(poses) and np.isfinite(poses[n]).all()}
