"""Groups of scans that are decoded and kept for a while: whoever asks for scans here and there decodes each group once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from threading import Lock
from typing import Any

from salpcc.pipeline.decode import PLAIN, DecodeOptions, decode_scans
from salpcc.schemas.scan import Scan
from salpcc.stages.residual_code.archive.reader import ArchiveReader


class DecodedGroups:
    """The groups that were asked for last, of any number of archives; threads may ask at once.

    A group is decoded up to the scan that is asked for, and on from there when a later one is. Nothing decoded is
    pickled.
    """

    def __init__(self, most: int, options: DecodeOptions = PLAIN) -> None:
        """Keep ``most`` groups, decoded by these options."""
        self.most, self.options = most, options
        self.decoded = 0  # groups that were begun, to see whether any was decoded twice
        self._groups: OrderedDict[tuple[str, int], _Group] = OrderedDict()
        self._lock = Lock()

    def scan(self, reader: ArchiveReader, gop: int, place: int) -> Scan:
        """Return a scan, whose arrays are shared with whoever asks for it again.

        Raises:
            ArchiveError: its group is damaged up to it.
            UsageError: a scan up to it is in no such frame.
        """
        key = str(reader.path), gop
        with self._lock:
            group = self._groups.get(key)
            if group is None:
                decoder = decode_scans(reader, gop, self.options)
                group = self._groups[key] = _Group(decoder)
                self.decoded += 1
            self._groups.move_to_end(key)
            while len(self._groups) > self.most:
                self._groups.popitem(last=False)
        try:
            return group.scan(place)
        except BaseException:
            with self._lock:  # a broken decoder must not be asked again
                self._groups.pop(key, None)
            raise

    def forget(self) -> None:
        """Let go of all of them."""
        with self._lock:
            self._groups.clear()

    def __getstate__(self) -> dict[str, Any]:
        return {"most": self.most, "options": self.options}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]


class _Group:
    def __init__(self, decoder: Iterator[Scan]) -> None:
        self._decoder = decoder
        self._scans: list[Scan] = []
        self._lock = Lock()

    def scan(self, place: int) -> Scan:
        with self._lock:
            while len(self._scans) <= place:
                self._scans.append(next(self._decoder))
        return self._scans[place]
