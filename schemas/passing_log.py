"""What of a log passes through an archive untouched: all but the clouds that are coded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from salpcc.schemas.log import Enclosed, LogChannel, LogMessage

_CHUNK_BYTES = 1 << 22  # before compression; a larger message has a chunk of its own


class PassingLog:
    """The channels of a log, its messages that pass through, handed out in chunks as time goes on, and what it encloses."""

    def __init__(
        self,
        channels: Iterable[LogChannel],
        messages: Iterator[LogMessage],
        enclosed: Iterable[Enclosed] = (),
    ) -> None:
        self.channels = tuple(channels)
        self.enclosed = enclosed
        self._messages = messages
        self._next = next(messages, None)

    @property
    def ended(self) -> bool:
        """Tell whether it has no message left to hand out."""
        return self._next is None

    def until(self, time: int | None) -> Iterator[list[LogMessage]]:
        """Yield chunks of what the log has before its first message after ``time``; None: of all that is left."""
        chunk: list[LogMessage] = []
        size = 0
        while self._next is not None and (time is None or self._next.log_time <= time):
            if chunk and size + len(self._next.data) > _CHUNK_BYTES:
                yield chunk
                chunk, size = [], 0
            chunk.append(self._next)
            size += len(self._next.data)
            self._next = next(self._messages, None)
        if chunk:
            yield chunk
