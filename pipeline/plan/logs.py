"""Whether what passed through into an archive is all that its log holds besides the coded scans."""

from __future__ import annotations

import hashlib
from collections import Counter
from itertools import zip_longest
from pathlib import Path

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.stages.ingest.sources.bag import count_log, differences, find_log, open_log
from salpcc.stages.residual_code.archive.reader import ArchiveReader

Identity = tuple[tuple[object, ...], int, int, int, bytes]


def compare_log(reader: ArchiveReader, root: Path, coded: Counter[str], whole: bool) -> tuple[int, list[str]]:
    """Compare what passed through with the log that it came from, byte for byte, and all that there is by counts.

    The log is read as it was for the archive, and counted by other means: what its reader passes over is missing
    in both, but not in the count.

    Args:
        coded: messages that were coded, by topic.
        whole: the archive is of all of the log, and not of some ``--frames``.

    Returns:
        the number of messages that passed, and what is wrong.

    Raises:
        SourceError: the log cannot be read.
    """
    path = find_log(root, reader.facts.sequence)
    log = open_log(path)
    counted = count_log(path)
    read: Counter[str] = Counter()
    there: Counter[Identity] = Counter()
    names = _names(log.channels)
    for message in log.messages():
        read[log.channels[message.channel].topic] += 1
        there[_identity(names[message.channel], message)] += 1
    passed: Counter[str] = Counter()
    here: Counter[Identity] = Counter()
    names = _names(reader.log)
    try:
        for message in reader.passing():
            passed[reader.log[message.channel].topic] += 1
            here[_identity(names[message.channel], message)] += 1
        same = all(one == other for one, other in zip_longest(reader.enclosed(), log.enclosed()))
    except ArchiveError as error:
        return 0, [str(error)]
    others = Counter(str(name[0]) for name, *_ in (here - there).elements())
    problems = [
        f"topic {topic}: {n} messages are not those of the log" for topic, n in sorted(others.items())
    ]
    if not same:
        problems.append("attachments or metadata are not those of the log")
    problems += differences(read, counted, f"of {path} are read")
    if whole:
        problems += differences(coded + passed, counted, "in the archive")
    return passed.total(), problems


def _names(channels: dict[int, LogChannel]) -> dict[int, tuple[object, ...]]:
    """Name channels by what they tell, and by the how manyth of these they are; ids are a log's and an archive's own."""
    seen: Counter[tuple[object, ...]] = Counter()
    names: dict[int, tuple[object, ...]] = {}
    for id_, channel in channels.items():
        told = channel.topic, channel.type, channel.encoding, channel.metadata
        names[id_] = (*told, seen[told])
        seen[told] += 1
    return names


def _identity(name: tuple[object, ...], message: LogMessage) -> Identity:
    digest = hashlib.sha256(message.data).digest()
    return name, message.log_time, message.publish_time, message.sequence, digest
