"""Where the scans of an archive were, as a file says in one of several formats, or the log that it was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.decode import DecodeOptions, decode_scans
from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.mapping.drive.logged_poses import poses_in_log
from salpcc.stages.mapping.drive.pose_files import read_trajectory
from salpcc.stages.mapping.drive.poses import poses_of, read_poses, read_sensor_poses
from salpcc.stages.residual_code.archive.reader import ArchiveReader

F64 = NDArray[np.float64]


def given_poses(source: str, reader: ArchiveReader) -> F64:
    """Return the poses ``(n, 4, 4)`` of all scans of an archive, sensor to map.

    ``source`` is a topic of the log that the archive was made of, or a file: KITTI's poses.txt with calib.txt beside it, by frame
    numbers; that of a map, with scans.txt beside it, by names; TUM's or EuRoC's, by times. Those with times are of the sensor.

    Raises:
        SourceError: no such file, none of these, or one that does not cover all scans; scans of several sensors, which poses of
            one would place wrong.
    """
    names = reader.names
    if not names:
        return np.empty((0, 4, 4))
    in_log = any(channel.topic == source for channel in reader.log.values())
    if in_log or several_topics(reader):
        frames = {
            payload.frame_id.strip("/") for gop in range(len(reader.gops)) for payload in reader.payloads(gop)
        }
        if len(frames) > 1:
            raise SourceError(
                f"{reader.path}: scans of several sensors ({', '.join(sorted(frames))}); take the topic of one with cut --topic"
            )
        if in_log:
            try:
                return poses_in_log(
                    source, reader.log, reader.passing(), frames.pop(), _instants(reader), names
                )
            except SourceError as error:
                raise SourceError(f"{reader.path}: {error}") from error
    path = Path(source)
    if not path.is_file():
        topics = ", ".join(sorted({channel.topic for channel in reader.log.values()}))
        raise SourceError(
            f"{path}: no poses there; name a file of poses (KITTI, TUM, EuRoC)"
            + (f", a topic with poses of the log ({topics})" if topics else "")
            + ", or use --poses odometry"
        )
    trajectory = read_trajectory(path)
    if trajectory is not None:
        return trajectory.at(_instants(reader), names)
    if path.with_name("scans.txt").is_file():
        return _by_name(names, path)
    return poses_of(names, read_poses(path), path)


def several_topics(reader: ArchiveReader) -> bool:
    """Tell whether an archive holds clouds of several topics of a log; their names begin with the topic then."""
    of_topics = {name.rpartition("-")[0] for name in reader.names}
    return bool(reader.log) and len(of_topics) > 1


def _instants(reader: ArchiveReader) -> list[int]:
    """Return when each scan says that it was taken, nanoseconds: the stamp of a message, which was logged later."""
    options = DecodeOptions("static" if reader.movable == "layered" else "all")
    first = next(gop for gop, entries in enumerate(reader.gops) if entries)
    if next(decode_scans(reader, first, options)).cloud is None:
        return [time for gop in range(len(reader.gops)) for time in reader.times(gop)]
    scans = (scan for gop in range(len(reader.gops)) for scan in decode_scans(reader, gop, options))
    return [scan.time if scan.cloud is None else scan.cloud.layout.stamp or scan.time for scan in scans]


def _by_name(names: list[str], path: Path) -> F64:
    """Pick the poses that were written beside a map."""
    poses = read_sensor_poses(path)
    at = {name: place for place, name in enumerate(frame_lines(path.with_name("scans.txt")))}
    for name in names:
        if at.get(name, len(poses)) >= len(poses):
            raise SourceError(
                f"{path}: no pose of scan {name}; name the poses of its sequence, or use --poses odometry"
            )
    return poses[[at[name] for name in names]]
