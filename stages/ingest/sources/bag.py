"""Recorded logs of any sensor: MCAP files, ROS 1 bags, ROS 2 bags; a sequence is a log, by its file's stem."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.cloud_layout import LayoutError
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LogWarning, SourceError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.files import is_url, location, reading, why
from salpcc.schemas.log import Log, LogChannel, LogMessage, LogMetadata
from salpcc.schemas.marks import at_rest, mark
from salpcc.schemas.messages import COMPRESSED
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import Known, ScanRef
from salpcc.stages.ingest.point_cloud import message_to_scan
from salpcc.stages.ingest.sources.base import Source
from salpcc.stages.ingest.sources.count import count_messages
from salpcc.stages.ingest.sources.mcap_log import McapLog
from salpcc.stages.ingest.sources.ros1_log import Ros1Log
from salpcc.stages.ingest.sources.rosbag2 import METADATA, is_rosbag2, read_rosbag2
from salpcc.stages.ingest.sources.sqlite_log import SqliteLog, beside, qos_text

Clouds = dict[str, list[tuple[int, tuple[int, ...]]]]  # by topic, the time of each and its place in the log


_SHOWN = 8  # topics in a message
_STORAGE = {".mcap": "mcap", ".bag": "ros1", ".db3": "sqlite3"}


class Bag(Source):
    """Point clouds (``sensor_msgs/PointCloud2``) of recorded logs, one topic or several."""

    name = "bag"
    passes = True
    hint = "Any log with sensor_msgs/PointCloud2: NAME.mcap, a ROS 1 NAME.bag, a ROS 2 bag folder or one NAME.db3 of it"

    def sequences(self, root: Path) -> list[str]:
        """List the logs in ``root``, or the one that ``root`` is."""
        if _is_log(root):
            return [root.stem]
        return sorted({path.stem for path in root.iterdir() if _is_log(path)}) if root.is_dir() else []

    def folder(self, root: Path, sequence: str) -> None:
        """Return None: what lies beside a log is not its own."""

    def scans(
        self, root: Path, sequence: str, topics: tuple[str, ...] = (), listed: Clouds | None = None
    ) -> list[ScanRef]:
        """List the clouds of a log by topic and time; ``topics``: of these only.

        With one topic a scan is named by its number, with more by its topic, too. ``listed`` is what
        :meth:`places` said of this very log; where it has the same topics, the log is not gone through again.
        Else it is, and what is read of each topic is compared with :func:`~.count.count_messages`.

        Raises:
            SourceError: it holds no clouds, or other numbers of messages are read than counted.

        Warns:
            LogWarning: what of the log stays behind, or is not as its metadata say.
        """
        path = find_log(root, sequence)
        log = open_log(path)
        _opened.cache_clear()  # whoever lists a log looks at it anew
        clouds = {channel.id: channel.topic for channel in log.channels.values() if channel.holds_clouds}
        there = sorted(set(clouds.values()))
        missing = [topic for topic in topics if topic not in there]
        if missing or not there or any(channel.type == COMPRESSED for channel in log.channels.values()):
            _check_clouds(path, log, there, missing)
        chosen = [topic for topic in there if topic in topics or not topics]
        found: Clouds = {topic: [] for topic in chosen}
        if listed and sorted(listed) == chosen:
            found = {topic: [(time, tuple(at)) for time, at in listed[topic]] for topic in chosen}
        else:
            read: Counter[str] = Counter()
            for message in log.messages():
                topic = log.channels[message.channel].topic
                read[topic] += 1
                if topic in found and message.channel in clouds:
                    found[topic].append((message.log_time, message.at))
            counted = count_log(path)
            if differing := differences(read, counted):
                raise SourceError(f"{path}: {differing[0]}; this log is not read right, it is left as it is")
            for line in caveats(path, log, counted):
                # A name may hold anything; it stays one line.
                warnings.warn(" ".join(f"{path}: {line}".split()), LogWarning, stacklevel=2)
        if not any(found.values()):
            raise SourceError(f"{path}: no messages on {', '.join(chosen)}, so there is nothing to code")
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
            scan = message_to_scan(message, channel.encoding, ref.topic, ref.name)
        except LayoutError as error:
            raise SourceError(f"{ref.path}: {ref.topic}, message {ref.number}: {error}") from error
        if scan.cloud is None or len(channels_of(scan.cloud, log.channels)) == 1:
            return scan
        return replace(scan, cloud=replace(scan.cloud, channel=channel.id))

    def there(self, root: Path) -> bool:
        """Tell whether ``root`` is a folder of logs, or a log."""
        return root.exists()

    def asked(self, root: Path, sequence: str, config: RunConfig, record: dict[str, Any]) -> list[ScanRef]:
        """List the clouds of the topics asked for; a log that has not changed since ``record`` is not gone through again.

        Warns:
            LogWarning: as :meth:`scans`, and of what passes through only in part, as frames were asked for.
        """
        path = find_log(root, sequence)
        same = log_mark(path) == record.get("files", {}).get(path.name, ("",))[0]
        refs = self.scans(root, sequence, config.topics, record.get("places") if same else None)
        others = {channel.topic for channel in open_log(path).channels.values()} - {ref.topic for ref in refs}
        if config.frames and others:
            line = f"{path}: of {', '.join(sorted(others))}, only what was recorded from the first to the last of these clouds is kept"
            warnings.warn(" ".join(line.split()), LogWarning, stacklevel=2)
        return refs

    def places(self, refs: Sequence[ScanRef]) -> Clouds:
        """Say by topic where the clouds of a log are."""
        found: Clouds = {}
        for ref in refs:
            found.setdefault(ref.topic, []).append((ref.time, ref.at))
        return found

    def recall(
        self, refs: Sequence[ScanRef], known: Known, config: RunConfig
    ) -> tuple[dict[str, str], Known]:
        """Return the digest of the log, which all its clouds share; it is read where the one on record does not hold."""
        path = location(refs[0].path)
        now = log_mark(path)
        holds = known.get(path.name, ("", ""))
        if holds[0] != now:
            rests = all(at_rest(file) for file in log_files(path))
            holds = now if rests else "", digest_log(path)
        return {refs[0].path: holds[1]}, {path.name: holds} if holds[0] else {}

    def digest(self, ref: ScanRef, with_labels: bool) -> tuple[list[Any], Known]:
        """Return topic and place of a cloud, and the digest of its log, that :meth:`recall` told."""
        return [ref.topic, ref.at, ref.digest], {}

    def passing(
        self, refs: Sequence[ScanRef], failed: Collection[str], frames: tuple[int, int] | None
    ) -> PassingLog:
        """Return all messages of other topics, the clouds that could not be coded, attachments and metadata.

        Without ``frames``, whoever takes the last message learns whether any is missing.

        Raises:
            SourceError: the log cannot be read, or what is coded and what passes through are not all that is counted.
        """
        path = location(refs[0].path)
        log = open_log(path)
        topics = {ref.topic for ref in refs}
        coded = Counter(ref.topic for ref in refs if ref.name not in failed)
        lost = {ref.at for ref in refs if ref.name in failed}
        first, last = min(ref.time for ref in refs), max(ref.time for ref in refs)

        def messages() -> Iterator[LogMessage]:
            kept = Counter(coded)
            for message in log.messages():
                channel = log.channels[message.channel]
                of_topics = channel.holds_clouds and channel.topic in topics
                if of_topics and message.at not in lost:
                    continue
                if of_topics or frames is None or first <= message.log_time <= last:
                    kept[channel.topic] += 1
                    yield message
            if frames is None and (missing := differences(kept, count_log(path), "to keep")):
                raise SourceError(f"{path}: {missing[0]}; no archive is made of it")

        return PassingLog(log.channels.values(), messages(), log.enclosed())


def _check_clouds(path: Path, log: Log, there: list[str], missing: list[str]) -> None:
    """Say why a log has nothing to code, or not what was asked for, and what to do about it."""
    of_ours = (isinstance(found, LogMetadata) and found.name == "salpcc" for found in log.enclosed())
    if any(channel.type == COMPRESSED for channel in log.channels.values()) and any(of_ours):
        raise SourceError(
            f"{path}: an archive of salpcc-pipeline, coded already; `salpcc-pipeline decode` gives the log back"
        )
    if missing:
        raise SourceError(
            f"{path}: topic {missing[0]} holds no point clouds (topics of sensor_msgs/PointCloud2: {', '.join(there) or 'none'})"
        )
    if not there:
        topics = sorted(
            {f"{channel.topic} ({channel.type or channel.encoding})" for channel in log.channels.values()}
        )
        raise SourceError(
            f"{path}: no point clouds, and only sensor_msgs/PointCloud2 is coded (raw packets: record what the sensor's "
            f"driver makes of them); its topics: {', '.join(topics[:_SHOWN]) or 'none'}{' …' * (len(topics) > _SHOWN)}"
        )


def channels_of(cloud: Cloud, channels: dict[int, LogChannel]) -> list[LogChannel]:
    """Return the channels of a log that a cloud may have come on, by its topic and encoding."""
    return [
        channel
        for channel in channels.values()
        if channel.topic == cloud.topic and channel.encoding == cloud.encoding and channel.holds_clouds
    ]


def count_log(path: Path) -> Counter[str]:
    """Count the messages of a log by topic, by other means than :func:`open_log` reads them."""
    return count_messages(*_parts(path))


def differences(read: Counter[str], counted: Counter[str], read_by: str = "read") -> list[str]:
    """Say of each topic that has other numbers of messages in two counts what they are."""
    return [
        f"topic {topic}: {read[topic]} messages {read_by}, {counted[topic]} counted"
        for topic in sorted(read.keys() | counted.keys())
        if read[topic] != counted[topic]
    ]


def caveats(path: Path, log: Log, counted: Counter[str]) -> list[str]:
    """Say what of a log stays behind, and what its metadata say that is not so; all of it has been gone through."""
    lines = [f"stays behind: {what}" for what in log.left_behind()]
    if not is_rosbag2(path):
        return lines
    bag = read_rosbag2(path)
    lines += bag.differences
    lines += [
        f"{METADATA} says {bag.counts[topic]} messages of {topic}, the files hold {counted[topic]}; all of these are kept"
        for topic in sorted(bag.counts.keys() | counted.keys())
        if bag.counts[topic] != counted[topic]
    ]
    for channel in log.channels.values():
        own = qos_text(dict(channel.metadata).get("offered_qos_profiles", ""))
        if bag.qos.get(channel.topic, own) != own:
            lines.append(
                f"stays behind: the QoS that {METADATA} gives {channel.topic}; the one in the file is kept"
            )
    return list(dict.fromkeys(lines))


def open_log(path: Path) -> Log:
    """Open a log of any kind.

    Raises:
        SourceError: unreadable, or no log.
    """
    storage, files = _parts(path)
    if storage == "mcap":
        return McapLog(files)
    if is_url(path):
        raise SourceError(f"{path}: only MCAP is read from a URL; copy this log to a folder")
    return SqliteLog(files) if storage == "sqlite3" else Ros1Log(path)


@lru_cache(maxsize=2)
def _opened(path: str, changed: str) -> Log:
    """A log that stays open in this process: a GOP reads many messages of it."""
    return open_log(location(path))


def _parts(path: Path) -> tuple[str, list[Path]]:
    """The storage of a log, and the files that hold its messages, in order."""
    if path.suffix in _STORAGE and (is_url(path) or not path.is_dir()):
        return _STORAGE[path.suffix], [path]
    bag = read_rosbag2(path)
    return bag.storage, list(bag.files)


def find_log(root: Path, sequence: str) -> Path:
    """Return the log of that name in ``root``, or ``root`` where it is the log.

    Raises:
        SourceError: there is none, or more than one.
    """
    if root.stem == sequence and _is_log(root):
        return root
    paths = [*(root / f"{sequence}{suffix}" for suffix in _STORAGE), root / sequence]
    found = [path for path in paths if _is_log(path)]
    if len(found) > 1:
        raise SourceError(f"{root}: holds {' and '.join(p.name for p in found)}; name the one that is meant")
    if found:
        return found[0]
    if _is_log(root):
        raise SourceError(
            f"{root}: a log of another name than {sequence}; if it is the one, name a link to it that is called {sequence}{root.suffix}"
        )
    if root.is_file():
        raise SourceError(no_log(root))
    raise SourceError(f"{root / sequence}: not found. {Bag.hint}")


def no_log(path: Path) -> str:
    """Say why something that is there is no log: it has another name than logs of its kind have, or is something else."""
    kind = kind_of(path)
    suffix = {"an MCAP file": ".mcap", "a ROS 1 bag": ".bag", "an SQLite file": ".db3"}.get(kind)
    if suffix is None:
        return f"{path}: {kind}, no log that is read here. {Bag.hint}"
    return f"{path}: {kind}, but its name does not end in {suffix}; rename it"


def _is_log(path: Path) -> bool:
    return (path.suffix in _STORAGE and path.is_file()) or is_rosbag2(path)


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
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.is_file())
    return [path, *(beside(path) if path.suffix == ".db3" else ())]


def _slugs(topics: list[str]) -> dict[str, str]:
    """What the names of scans of each topic start with; nothing for a single topic."""
    if len(topics) == 1:
        return {topics[0]: ""}
    slugs = {topic: re.sub(r"[^A-Za-z0-9]+", "_", topic).strip("_") or "topic" for topic in topics}
    alike = len(set(slugs.values())) < len(slugs)
    return {topic: f"{n}-{slugs[topic]}-" if alike else f"{slugs[topic]}-" for n, topic in enumerate(topics)}
