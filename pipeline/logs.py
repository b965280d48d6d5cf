"""What of a log its archive holds besides the coded scans, and the way back to a log."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

from salpcc.pipeline.plan import SequencePlan
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.files import location
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.stages.ingest.sources.bag import find_log, open_log
from salpcc.stages.residual_code.archive_reader import ArchiveReader
from salpcc.stages.residual_code.passing import PassingLog


def passing_log(plan: SequencePlan, failed: set[str], config: RunConfig) -> PassingLog | None:
    """Return what passes through from the log of a sequence; None where it was no log.

    That is all messages of other topics, the clouds that could not be coded (``failed``, by scan name), attachments
    and metadata.
    With ``--frames`` it is what lies between the first and the last scan.

    Raises:
        SourceError: the log cannot be read.
    """
    refs = [ref for gop in plan.gops for ref in gop.scans]
    if not refs or not refs[0].topic:
        return None
    log = open_log(location(refs[0].path))
    topics = {ref.topic for ref in refs}
    lost = {(ref.topic, ref.time, ref.at) for ref in refs if ref.name in failed}
    first, last = min(ref.time for ref in refs), max(ref.time for ref in refs)

    def messages() -> Iterator[LogMessage]:
        for message in log.messages():
            channel = log.channels[message.channel]
            if channel.holds_clouds and channel.topic in topics:
                if (channel.topic, message.log_time, message.at) in lost:
                    yield message
            elif config.frames is None or first <= message.log_time <= last:
                yield message

    return PassingLog(log.channels.values(), messages(), log.enclosed())


def compare_passing(reader: ArchiveReader, root: Path, scans: int | None) -> tuple[int, list[str]]:
    """Compare what passed through with the log that it came from, byte for byte.

    Args:
        scans: messages that were coded instead, where all others should be there; None after ``--frames``.

    Returns:
        the number of messages, and what is wrong.

    Raises:
        SourceError: the log cannot be read.
    """
    log = open_log(find_log(root, reader.facts.sequence))
    there = Counter(_identity(log.channels[m.channel], m) for m in log.messages())
    try:
        here = Counter(_identity(reader.log[m.channel], m) for m in reader.passing())
        same = all(one == other for one, other in zip_longest(reader.enclosed(), log.enclosed()))
    except ArchiveError as error:
        return 0, [str(error)]
    topics = Counter(topic for topic, *_ in (here - there).elements())
    problems = [
        f"topic {topic}: {n} messages are not those of the log" for topic, n in sorted(topics.items())
    ]
    if not same:
        problems.append("attachments or metadata are not those of the log")
    if scans is not None and here.total() + scans != there.total():
        problems.append(f"{there.total() - scans - here.total()} messages of the log are missing")
    return here.total(), problems


def _identity(channel: LogChannel, message: LogMessage) -> tuple[str, str, int, int, int, bytes]:
    digest = hashlib.sha256(message.data).digest()
    return channel.topic, channel.type, message.log_time, message.publish_time, message.sequence, digest
