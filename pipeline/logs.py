"""What of a log its archive holds besides the coded scans, and the way back to a log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from salpcc.pipeline.plan import SequencePlan
from salpcc.schemas.config import RunConfig
from salpcc.schemas.log import LogMessage
from salpcc.stages.ingest.sources.bag import open_log
from salpcc.stages.residual_code.passing import PassingLog


def passing_log(plan: SequencePlan, failed: set[str], config: RunConfig) -> PassingLog | None:
    """Return what passes through from the log of a sequence; None where it was no log.

    That is all messages of other topics, and the clouds that could not be coded (``failed``, by scan name).
    With ``--frames`` it is what lies between the first and the last scan.

    Raises:
        SourceError: the log cannot be read.
    """
    refs = [ref for gop in plan.gops for ref in gop.scans]
    if not refs or not refs[0].topic:
        return None
    log = open_log(Path(refs[0].path))
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

    return PassingLog(log.channels.values(), messages())
