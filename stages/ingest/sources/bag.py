"""Recorded logs of any sensor: MCAP files, ROS 1 bags, ROS 2 bags; a sequence is a log, by its file's stem."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from salpcc.schemas.cloud_layout import LayoutError
from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import is_url, location, reading, why
from salpcc.schemas.log import Log
from salpcc.schemas.marks import mark
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.point_cloud import message_to_scan
from salpcc.stages.ingest.sources.mcap_log import McapLog
from salpcc.stages.ingest.sources.ros_log import RosLog

Clouds = dict[str, list[tuple[int, tuple[int, ...]]]]  # by topic, the time of each and its place in the log


class Bag:
    """Point clouds (``sensor_msgs/PointCloud2``) of recorded logs, one topic or several."""

    name = "bag"
    hint = "Any log with sensor_msgs/PointCloud2: NAME.mcap, a ROS 1 NAME.bag, or a ROS 2 bag folder"

    def sequences(self, root: Path) -> list[str]:
        """List the logs in ``root``, or the one that ``root`` is."""
        if _is_log(root):
            return [root.stem]
        return sorted({path.stem for path in root.iterdir() if _is_log(path)}) if root.is_dir() else []

    def scans(
        self, root: Path, sequence: str, topics: tuple[str, ...] = (), listed: Clouds | None = None
    ) -> list[ScanRef]:
        """List the clouds of a log by topic and time; ``topics``: of these only.

        With one topic a scan is named by its number, with more by its topic, too. ``listed`` is what
        :func:`clouds_of` said of this very log; where it has the same topics, the log is not gone through again.
        """
        path = find_log(root, sequence)
        log = open_log(path)
        _opened.cache_clear()  # whoever lists a log looks at it anew
        clouds = {channel.id: channel.topic for channel in log.channels.values() if channel.holds_clouds}
        there = sorted(set(clouds.values()))
        missing = [topic for topic in topics if topic not in there]
        if missing or not there:
            said = f"topic {missing[0]} holds no point clouds" if missing else "no point clouds"
            raise SourceError(
                f"{path}: {said} (topics of sensor_msgs/PointCloud2: {', '.join(there) or 'none'})"
            )
        chosen = [topic for topic in there if topic in topics or not topics]
        wanted = {id_ for id_, topic in clouds.items() if topic in chosen}
        found: Clouds = {topic: [] for topic in chosen}
        if listed and sorted(listed) == chosen:
            found = {topic: [(time, tuple(at)) for time, at in listed[topic]] for topic in chosen}
        else:
            for message in log.messages(wanted):
                found[clouds[message.channel]].append((message.log_time, message.at))
        slugs = _slugs(chosen)
        return [
            ScanRef(f"{slugs[topic]}{n:06d}", n, str(path), time, topic=topic, at=at)
            for topic in chosen
            for n, (time, at) in enumerate(sorted(found[topic]))
        ]

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        """Read one cloud; logs have no labels."""
        if with_labels:
            raise SourceError(f"{ref.path}: logs have no labels; use --labels network")
        log = _opened(ref.path, log_mark(location(ref.path)))
        message = log.message(ref.topic, ref.time, ref.at)
        channel = log.channels[message.channel]
        try:
            return message_to_scan(message, channel.encoding, ref.topic, ref.name)
        except LayoutError as error:
            raise SourceError(f"{ref.path}: {ref.topic}, message {ref.number}: {error}") from error


def clouds_of(refs: Iterable[ScanRef]) -> Clouds:
    """Say by topic where the clouds of a log are; nothing of scans that are files."""
    found: Clouds = {}
    for ref in refs:
        if ref.topic:
            found.setdefault(ref.topic, []).append((ref.time, ref.at))
    return found


def open_log(path: Path) -> Log:
    """Open a log of any kind.

    Raises:
        SourceError: unreadable, or no log.
    """
    if path.suffix == ".mcap":
        return McapLog([path])
    files = mcap_files(path)
    if not files and is_url(path):
        raise SourceError(f"{path}: only MCAP is read from a URL; copy this log to a folder")
    return McapLog(files) if files else RosLog(path)


@lru_cache(maxsize=2)
def _opened(path: str, changed: str) -> Log:
    """A log that stays open in this process: a GOP reads many messages of it."""
    return open_log(location(path))


def mcap_files(path: Path) -> list[Path]:
    """The files of a ROS 2 bag in plain MCAP; none for any other bag."""
    about = _metadata(path)
    if about.get("storage_identifier") != "mcap" or str(about.get("compression_mode", "")).lower() not in (
        "",
        "none",
    ):
        return []
    # A name leads into the bag's folder and nowhere else.
    return [path / Path(str(name)).name for name in about.get("relative_file_paths", [])]


def _metadata(path: Path) -> dict[str, Any]:
    try:
        document = yaml.safe_load((path / "metadata.yaml").read_text())
        return dict(document["rosbag2_bagfile_information"])
    except (OSError, yaml.YAMLError, ValueError, KeyError, TypeError, RecursionError):
        return {}  # whoever reads it as a bag will say what is wrong


def find_log(root: Path, sequence: str) -> Path:
    """Return the log of that name in ``root``, or ``root`` where it is the log.

    Raises:
        SourceError: there is none.
    """
    if root.stem == sequence and _is_log(root):
        return root
    for path in (root / f"{sequence}.mcap", root / f"{sequence}.bag", root / sequence):
        if _is_log(path):
            return path
    raise SourceError(f"{root / sequence}: not found. {Bag.hint}")


def _is_log(path: Path) -> bool:
    return (path.suffix in (".mcap", ".bag") and path.is_file()) or (path / "metadata.yaml").is_file()


def digest_log(path: Path) -> str:
    """SHA-256 over the bytes of a log's files."""
    digest = hashlib.sha256()
    try:
        for file in log_files(path):
            with reading(file) as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
    return digest.hexdigest()


def log_mark(path: Path) -> str:
    """What changes whenever a file of a log does; see :func:`~salpcc.schemas.marks.mark`."""
    try:
        return " | ".join(mark(file) for file in log_files(path))
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error


def log_files(path: Path) -> list[Path]:
    """List the files that a log is."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def _slugs(topics: list[str]) -> dict[str, str]:
    """What the names of scans of each topic start with; nothing for a single topic."""
    if len(topics) == 1:
        return {topics[0]: ""}
    slugs = {topic: re.sub(r"[^A-Za-z0-9]+", "_", topic).strip("_") or "topic" for topic in topics}
    alike = len(set(slugs.values())) < len(slugs)
    return {topic: f"{n}-{slugs[topic]}-" if alike else f"{slugs[topic]}-" for n, topic in enumerate(topics)}
