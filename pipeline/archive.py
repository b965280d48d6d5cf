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

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, Self, get_args, overload

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError, KindError, UsageError
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.schemas.work import Movable
from salpcc.stages.ingest.sources.velodyne_bin import NOMINAL_PERIOD_NS
from salpcc.stages.lattice.frame import FRAMES, Frame
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.format import ScanPayload, frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.salvage import Salvage
from salpcc.stages.residual_code.gop import decode_any, layered_scan, scan_of
from salpcc.stages.residual_code.label_coder import labelled
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan

Layers = Literal["all", "static", "movable"]
LAYERS: tuple[str, ...] = get_args(Layers)

_FASTEST, _SLOWEST = 10**7, 10**9  # nanoseconds of a turn that can be
_SHOWN = 5  # scans of each end in a notebook


def check_layers(reader: ArchiveReader, layers: Layers) -> None:
    """Refuse to open a layer that an archive does not hold.

    Raises:
        UsageError: so it is; the message says why.
    """
    if layers == "static" and reader.movable == "one layer":
        raise UsageError(
            f"{reader.path}: one layer, nothing tells what may move; encode it without --keep-movable"
        )
    if layers == "movable" and reader.movable != "layered":
        what = "was dropped" if reader.movable == "dropped" else "is in one layer with the rest"
        raise UsageError(f"{reader.path}: has no movable layer; what may move {what}")


def decode_scans(
    reader: ArchiveReader | Salvage,
    gop: int,
    layers: Layers = "all",
    labels: bool = False,
    frame: Frame = "recorded",
) -> Iterator[Scan]:
    """Decode the scans of one GOP, one after the other.

    Args:
        layers: ``static`` reads no byte of the movable layer's chunks; ``all`` is the scans as they were recorded, as far
            as the archive holds them.
        labels: decode the labels that the archive holds, too.
        frame: in which the points are given (:mod:`salpcc.stages.lattice.frame`).

    Raises:
        ArchiveError: a payload is damaged, or the movable layer asked for is gone; the message names the first scan that
            did not come back.
        UsageError: a scan is in no such frame.
    """
    layered = layers != "static" and reader.movable == "layered"
    payloads = reader.payloads(gop)
    if layered:
        movable = reader.movable_payloads(gop)
        pairs = zip_longest(payloads, movable[: len(payloads)])
        payloads = [replace(payload, movable=layer) for payload, layer in pairs]
    turn = 0 if frame == "recorded" or isinstance(reader, Salvage) else turn_ns(reader)
    scans = decoded_scans(payloads, reader.facts.sensor, layered, layers == "movable", labels, frame, turn)
    for payload in payloads:
        try:
            yield next(scans)
        except StopIteration:
            raise ArchiveError(f"{reader.path}: scan {payload.entry.name} is missing from its GOP") from None
        except (ArchiveError, UsageError) as error:
            raise type(error)(f"{reader.path}: scan {payload.entry.name}: {error}") from error


def turn_ns(reader: ArchiveReader) -> int:
    """Nanoseconds of a turn of the sensor: the mean of the archive, by its scans' times and frame numbers, else 0.1 s."""
    names = [entry.name for gop in reader.gops for entry in gop]
    first, last = reader.span
    turns = frame_number(names[-1], len(names) - 1) - frame_number(names[0], 0) if names else 0
    turn = (last - first) // turns if turns > 0 else 0
    return turn if _FASTEST <= turn <= _SLOWEST else NOMINAL_PERIOD_NS


def decoded_scans(
    payloads: list[ScanPayload],
    sensor: SensorModel,
    layered: bool,
    alone: bool = False,
    labels: bool = False,
    frame: Frame = "recorded",
    turn: int = 0,
) -> Iterator[Scan]:
    """Decode the payloads of one GOP.

    Args:
        layered: take their movable layers, too; ``alone``: give these only.
        labels: decode the labels, where there are some.
        frame, turn: in which the points are given, and the nanoseconds of a turn.

    Raises:
        ArchiveError: the next payload is damaged, or lacks its movable layer.
        UsageError: the next scan is in no such frame.
    """
    state = GopState(sensor)
    sweeps = decode_any((payload.data for payload in payloads), sensor)
    for payload, sweep in zip(payloads, sweeps, strict=False):
        if labels and isinstance(sweep, Sweep):
            sweep = labelled(sweep, payload.labels, sensor)
        if layered:
            if payload.movable is None:
                raise ArchiveError("its movable layer is gone; --layers static gives what is left")
            assert isinstance(sweep, Sweep)
            moving = decode_scan(payload.movable.data, sensor, state, sweep)
            if labels:
                moving = labelled(moving, payload.movable.labels, sensor)
            scan = layered_scan(sweep, moving, sensor, alone, frame, turn)
        else:
            scan = scan_of(sweep, sensor, frame, turn)
        yield replace(scan, name=payload.entry.name, time=payload.time, frame_id=payload.frame_id)


def decode_groups(
    reader: ArchiveReader | Salvage,
    gops: Iterable[int],
    threads: int = 1,
    layers: Layers = "all",
    labels: bool = False,
    frame: Frame = "recorded",
) -> Iterator[Iterator[Scan]]:
    """Decode GOPs, one iterator of scans for each; with several threads, as many GOPs at once.

    Kernels run without the interpreter's lock, so threads are as good as processes, and no scan has to be copied. Then
    a GOP is decoded before its first scan is given, and up to ``threads`` more wait in memory. What comes is the same
    with any number; an iterator raises what :func:`decode_scans` does, after the same scans.
    """
    if threads <= 1:
        yield from (decode_scans(reader, gop, layers, labels, frame) for gop in gops)
        return
    ahead: deque[Future[tuple[list[Scan], Exception | None]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for gop in gops:
                ahead.append(pool.submit(_decoded, reader, gop, layers, labels, frame))
                if len(ahead) > threads:
                    yield _given(*ahead.popleft().result())
            while ahead:
                yield _given(*ahead.popleft().result())
        finally:
            for future in ahead:
                future.cancel()


def _decoded(
    reader: ArchiveReader | Salvage, gop: int, layers: Layers, labels: bool, frame: Frame
) -> tuple[list[Scan], Exception | None]:
    scans: list[Scan] = []
    try:
        scans.extend(decode_scans(reader, gop, layers, labels, frame))  # keeps those before an error
    except Exception as error:  # noqa: BLE001 (whoever asks for the scan gets it)
        return scans, error
    return scans, None


def _given(scans: list[Scan], error: Exception | None) -> Iterator[Scan]:
    yield from scans
    if error is not None:
        raise error


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
    """

    _gop: int  # the GOP in hand, -1 for none
    _decoded: list[Scan]  # its scans so far
    _decoder: Iterator[Scan]  # gives the rest

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
            UsageError: the archive has no such layer; there is no such frame.
        """
        if frame not in FRAMES:
            raise UsageError(f"frame {frame!r}: choose from {', '.join(FRAMES)}")
        if layers not in LAYERS:
            raise UsageError(f"layers {layers!r}: choose from {', '.join(LAYERS)}")
        self._reader = ArchiveReader(path)
        self._layers, self._frame = layers, frame
        check_layers(self._reader, layers)
        self._threads = threads
        self._places = [(g, i) for g, gop in enumerate(self._reader.gops) for i in range(len(gop))]
        self._forget()

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
        self._forget()

    def __repr__(self) -> str:
        scans = f"{self.sequence!r}, {len(self)} scan{'' if len(self) == 1 else 's'}"
        return f"Archive({scans}, {self.sensor.name}, {str(self._reader.path)!r})"

    def _repr_html_(self) -> str:
        """Show what it is, and its first and last scans, in a notebook."""
        reader = self._reader
        of_layers = {"all": reader.entries, "static": reader.gops, "movable": reader.movable_gops}
        entries = [entry for gop in of_layers[self._layers] for entry in gop]
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
        return [self._reader.gops[g][i].name for g, i in self._places]

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

    @overload
    def __getitem__(self, index: int | str) -> Scan: ...
    @overload
    def __getitem__(self, index: slice) -> list[Scan]: ...
    def __getitem__(self, index: int | str | slice) -> Scan | list[Scan]:
        """Return a scan by its place or by its name, or those of a slice of places.

        Raises:
            IndexError, KeyError: there is none at that place, or of that name.
            ArchiveError: its GOP is damaged.
        """
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if isinstance(index, str):
            try:
                index = self.names.index(index)
            except ValueError:
                held = f"{self.names[0]} to {self.names[-1]}" if len(self) else "none"
                raise KeyError(f"scan {index} is not in {self._reader.path}, which holds {held}") from None
        if not -len(self) <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        gop, place = self._places[index]
        if gop != self._gop:
            decoder = decode_scans(self._reader, gop, self._layers, True, self._frame)
            self._gop, self._decoded, self._decoder = gop, [], decoder
        try:
            while len(self._decoded) <= place:
                self._decoded.append(next(self._decoder))
        except BaseException:
            self._forget()  # a broken decoder must not be asked again
            raise
        return _detached(self._decoded[place])

    def __iter__(self) -> Iterator[Scan]:
        gops = range(len(self._reader.gops))
        for scans in decode_groups(self._reader, gops, self._threads, self._layers, True, self._frame):
            yield from map(_detached, scans)

    def __getstate__(self) -> dict[str, Any]:
        return {
            "reader": self._reader,
            "threads": self._threads,
            "layers": self._layers,
            "frame": self._frame,
            "places": self._places,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._reader, self._threads, self._places = state["reader"], state["threads"], state["places"]
        self._layers, self._frame = state["layers"], state["frame"]
        self._forget()

    def _forget(self) -> None:
        self._gop, self._decoded, self._decoder = -1, [], iter(())
