"""The Python door to archives: open, count, index, iterate.

::

    from salpcc import Archive

    with Archive.open("04.mcap") as archive:
        scan = archive[3]  # decodes the GOP of scan 3, up to it
        scan = archive["000003"]  # by its name
        scan = archive.at(300_000_000)  # the nearest in time, ns
        for scan in archive:
            scan.points, scan.intensity, scan.classes, scan.time, scan.motion
"""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.decode import DecodeOptions, Layers, check_layers, decode_groups
from salpcc.pipeline.decoded_groups import DecodedGroups
from salpcc.schemas.errors import KindError, UsageError
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import Movable
from salpcc.stages.lattice.frame import Frame
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.format import frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader

_SHOWN = 5  # scans of each end in a notebook


def _detached(scan: Scan) -> Scan:
    """Copy the arrays of a scan, so that whoever writes into them changes nothing that is decoded later."""
    return replace(
        scan,
        points=scan.points.copy(),
        intensity=scan.intensity.copy(),
        classes=None if scan.classes is None else scan.classes.copy(),
        motion=None if scan.motion is None else scan.motion.copy(),
        movable=None if scan.movable is None else scan.movable.copy(),
        labels=None if scan.labels is None else scan.labels.copy(),
        offset=None if scan.offset is None else scan.offset.copy(),
        cloud=scan.cloud and replace(scan.cloud, rest=scan.cloud.rest.copy()),
    )


class Archive(Sequence[Scan]):
    """The scans of one archive as a read-only sequence.

    Random access decodes at most one GOP, from its first scan to the one asked for; going on from there
    decodes each scan once. Only the GOP in hand is kept in memory. An archive can be pickled and
    forked: a copy starts with nothing decoded and shares no open file. Arrays of its scans are the caller's own.

    >>> from salpcc import Archive, Scan, encode_scans
    >>> points = np.arange(6, dtype=np.float32).reshape(2, 3)
    >>> scans = (Scan(f"{n:06d}", points + n, points[:, 0], time=n * 10**8) for n in range(4))
    >>> path = encode_scans(scans, folder / "four.mcap", effort="fast", gop=2)
    >>> with Archive.open(path) as archive:
    ...     len(archive), archive[2].name, archive["000003"].time, archive.at(90_000_000).name
    (4, '000002', 300000000, '000001')
    >>> [scan.points[0, 0].item() for scan in archive[1:]]
    [1.0, 2.0, 3.0]
    """

    def __init__(
        self, path: str | Path, threads: int = 1, layers: Layers = "all", frame: Frame = "recorded"
    ) -> None:
        """Open an archive.

        Args:
            path: the file, or its URL.
            threads: GOPs that are decoded at once while one iterates, and kept in memory; the scans are the same.
            layers: ``all`` there is, as it was recorded; ``static`` without what may move, of which no byte is read;
                ``movable`` that alone.
            frame: ``recorded``; ``sensor``, as it was measured, motion compensation undone; ``start`` or ``end``, as seen
                from where the sensor was then. Of these, scans have an ``offset`` a point.

        Raises:
            ArchiveError: not an archive, damaged, truncated, or of a newer major version.
            UsageError: the archive has no such layer; there is no such frame; less than one thread.
        """
        if not isinstance(threads, int) or threads < 1:
            raise UsageError(f"threads {threads!r}: a whole number from 1 on")
        self._options = DecodeOptions(layers, True, frame)
        self._reader = ArchiveReader(path)
        check_layers(self._reader, layers)
        self._threads = threads
        self._places = [(g, i) for g, gop in enumerate(self._reader.gops) for i in range(len(gop))]
        self._in_hand = DecodedGroups(1, self._options)

    @classmethod
    def open(
        cls, path: str | Path, threads: int = 1, layers: Layers = "all", frame: Frame = "recorded"
    ) -> Archive:
        """Open an archive; the same as the constructor, reads well in a ``with`` statement."""
        return cls(path, threads, layers, frame)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the decoded scans; no file stays open, and the archive can still be used."""
        self._in_hand.forget()

    def __repr__(self) -> str:
        scans = f"{self.sequence!r}, {len(self)} scan{'' if len(self) == 1 else 's'}"
        return f"Archive({scans}, {self.sensor.name}, {str(self._reader.path)!r})"

    def _repr_html_(self) -> str:
        """Show what it is, and its first and last scans, in a notebook."""
        reader = self._reader
        of_layers = {"all": reader.entries, "static": reader.gops, "movable": reader.movable_gops}
        entries = [entry for gop in of_layers[self._options.layers] for entry in gop]
        few = [*entries[:_SHOWN], None, *entries[-_SHOWN:]] if len(entries) > 2 * _SHOWN else entries
        rows = "".join(
            f"<tr><td>{escape(entry.name)}</td><td>{entry.kept:,}</td></tr>"
            if entry
            else "<tr><td>…</td><td></td></tr>"
            for entry in few
        )
        return f"<p>{escape(repr(self))}, {self._reader.size:,} bytes</p><table><tr><th>scan</th><th>points</th></tr>{rows}</table>"

    @property
    def sequence(self) -> str:
        """Name of the sequence."""
        return self._reader.facts.sequence

    @property
    def sensor(self) -> SensorModel:
        """The sensor model that the archive carries."""
        return self._reader.facts.sensor

    @property
    def config(self) -> dict[str, Any]:
        """The configuration that the archive was coded with."""
        return self._reader.facts.config

    @property
    def movable(self) -> Movable:
        """What became of what may move: ``layered``, ``dropped``, or ``one layer``."""
        return self._reader.movable

    @property
    def log(self) -> dict[int, LogChannel]:
        """Channels of the log that the scans are from; empty where they were files."""
        return self._reader.log

    def passing(self) -> Iterator[LogMessage]:
        """Yield the log's messages that are no scans, untouched, in its order."""
        return self._reader.passing()

    @property
    def passing_topics(self) -> list[str]:
        """Topics of these messages, sorted."""
        return self._reader.passing_topics

    @property
    def has_classes(self) -> bool:
        """Tell whether points have classes, or labels as annotated."""
        return self._reader.has_classes or self._reader.has_labels

    @property
    def side(self) -> list[str]:
        """Names of the side files that it holds, such as ``poses.txt``."""
        return list(self._reader.side)

    def side_file(self, name: str) -> bytes:
        """Return the content of a side file.

        Raises:
            KeyError: it holds none of that name.
            ArchiveError: it is damaged.
        """
        if name not in self._reader.side:
            held = ", ".join(self.side) or "none"
            raise KeyError(f"side file {name} is not in {self._reader.path}, which holds {held}")
        return self._reader.side_file(name).data

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield the log's attachments and metadata, in its order."""
        return self._reader.enclosed()

    @property
    def names(self) -> list[str]:
        """Names of the scans, in order."""
        return self._reader.names

    @cached_property
    def times(self) -> NDArray[np.int64]:
        """Time stamps ``(len(self),)`` of the scans in ns, in their order; no scan is decoded for them."""
        return np.array(
            [t for gop in range(len(self._reader.gops)) for t in self._reader.times(gop)], np.int64
        )

    def at(self, time: int) -> Scan:
        """Return the scan whose time stamp (ns) is nearest to one; of two, the one before.

        Raises:
            KindError: the time is no whole number.
            IndexError: the archive holds no scan.
            ArchiveError: its GOP is damaged.
        """
        if not isinstance(time, int | np.integer) or isinstance(time, bool):
            raise KindError(f"time {time!r} is no whole number of nanoseconds, as those of scans are")
        if not len(self):
            raise IndexError(f"{self._reader.path} holds no scan")
        distance = np.abs(self.times - min(max(int(time), 0), (1 << 63) - 1))
        return self[int(np.lexsort((self.times, distance))[0])]

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, scan: object) -> bool:
        """Tell whether it holds a scan of that name; those that it gives are new each time, and no other's."""
        return isinstance(scan, str) and scan in self.names

    @overload
    def __getitem__(self, index: int | str) -> Scan: ...
    @overload
    def __getitem__(self, index: slice) -> list[Scan]: ...
    def __getitem__(self, index: int | str | slice) -> Scan | list[Scan]:
        """Return a scan by its place or by its name, or those of a slice of places.

        Raises:
            IndexError, KeyError: there is none at that place, or of that name.
            KindError: it is neither.
            ArchiveError: its GOP is damaged.
        """
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if isinstance(index, str):
            try:
                index = self.names.index(index)
            except ValueError:
                raise KeyError(f"scan {index} is not in {self._reader.path}; {self._reader.held}") from None
        try:
            index = operator.index(index)
        except TypeError:
            kind = type(index).__name__
            raise KindError(f"{kind}: scans are asked for by place, by name, or by a slice") from None
        if not -len(self) <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        return _detached(self._in_hand.scan(self._reader, *self._places[index]))

    def of_frames(self, frames: tuple[int, int] | None, without: Collection[str] = ()) -> Iterator[Scan]:
        """Yield the scans of frames ``[first, last)``, or all: a frame's number is the name where that is one, else the place.

        Those of the names ``without`` are left out, unless no others are there.

        Raises:
            UsageError: there is none.
        """
        if frames is None and (len(self) or self.log) and not without:
            yield from self
            return
        names = self.names
        places = self._places_of(frames)
        if not places:
            raise UsageError(f"{self._reader.path}: no scan of it is of these frames; {self._reader.held}")
        for place in [place for place in places if names[place] not in without] or places:
            yield self[place]

    def bare(self, frames: tuple[int, int] | None = None) -> list[str]:
        """Name the scans, of these frames, whose movable layer is asked for and gone: what ``recover`` could not save."""
        if self._options.layers == "static" or self.movable != "layered":
            return []
        names, reader = self.names, self._reader
        pairs = zip(reader.gops, reader.movable_gops, strict=True)
        gone = {entry.name for gop, layer in pairs for entry in gop[len(layer) :]}
        return [names[place] for place in self._places_of(frames) if names[place] in gone]

    def _places_of(self, frames: tuple[int, int] | None) -> list[int]:
        return [
            place
            for place, name in enumerate(self.names)
            if frames is None or frames[0] <= frame_number(name, place) < frames[1]
        ]

    def __iter__(self) -> Iterator[Scan]:
        gops = range(len(self._reader.gops))
        for scans in decode_groups(self._reader, gops, self._threads, self._options):
            yield from map(_detached, scans)
