"""Decode groups of scans from what a reader gives: whole scans again, or one layer of them, as recorded or in another frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Literal, get_args

from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
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


@dataclass(frozen=True)
class DecodeOptions:
    """What of scans is decoded, and how it is given.

    Attributes:
        layers: ``all`` is the scans as they were recorded, as far as the archive holds them; ``static`` reads no byte of the
            movable layer's chunks; ``movable`` is that alone.
        labels: decode the labels that the archive holds, too.
        frame: in which the points are given (:mod:`salpcc.stages.lattice.frame`).

    Raises:
        UsageError: there are no such layers, or no such frame.
    """

    layers: Layers = "all"
    labels: bool = False
    frame: Frame = "recorded"

    def __post_init__(self) -> None:
        for name, value, known in (("frame", self.frame, FRAMES), ("layers", self.layers, LAYERS)):
            if value not in known:
                raise UsageError(f"{name} {value!r}: choose from {', '.join(known)}")


PLAIN = DecodeOptions()


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


def decode_scans(reader: ArchiveReader | Salvage, gop: int, options: DecodeOptions = PLAIN) -> Iterator[Scan]:
    """Decode the scans of one GOP, one after the other.

    Raises:
        ArchiveError: a payload is damaged, or the movable layer asked for is gone; the message names the first scan that
            did not come back.
        UsageError: a scan is in no such frame.
    """
    layered = options.layers != "static" and reader.movable == "layered"
    payloads = reader.payloads(gop)
    if layered:
        movable = reader.movable_payloads(gop)
        pairs = zip_longest(payloads, movable[: len(payloads)])
        payloads = [replace(payload, movable=layer) for payload, layer in pairs]
    turn = 0 if options.frame == "recorded" or isinstance(reader, Salvage) else turn_ns(reader)
    scans = decoded_scans(payloads, reader.facts.sensor, layered, options, turn)
    for payload in payloads:
        try:
            yield next(scans)
        except StopIteration:
            raise ArchiveError(f"{reader.path}: scan {payload.entry.name} is missing from its GOP") from None
        except (ArchiveError, UsageError) as error:
            raise type(error)(f"{reader.path}: scan {payload.entry.name}: {error}") from error


def turn_ns(reader: ArchiveReader) -> int:
    """Nanoseconds of a turn of the sensor: the mean of the archive, by its scans' times and frame numbers, else 0.1 s."""
    names = reader.names
    first, last = reader.span
    turns = frame_number(names[-1], len(names) - 1) - frame_number(names[0], 0) if names else 0
    turn = (last - first) // turns if turns > 0 else 0
    return turn if _FASTEST <= turn <= _SLOWEST else NOMINAL_PERIOD_NS


def decoded_scans(
    payloads: list[ScanPayload],
    sensor: SensorModel,
    layered: bool,
    options: DecodeOptions = PLAIN,
    turn: int = 0,
) -> Iterator[Scan]:
    """Decode the payloads of one GOP.

    Args:
        layered: they have movable layers, which are taken, too.
        turn: nanoseconds of a turn, for frames other than the recorded one.

    Raises:
        ArchiveError: the next payload is damaged, or lacks its movable layer.
        UsageError: the next scan is in no such frame.
    """
    state = GopState(sensor)
    sweeps = decode_any((payload.data for payload in payloads), sensor)
    for payload, sweep in zip(payloads, sweeps, strict=False):
        if options.labels and isinstance(sweep, Sweep):
            sweep = labelled(sweep, payload.labels, sensor)
        if layered:
            if payload.movable is None:
                raise ArchiveError("its movable layer is gone; --layers static gives what is left")
            assert isinstance(sweep, Sweep)
            moving = decode_scan(payload.movable.data, sensor, state, sweep)
            if options.labels:
                moving = labelled(moving, payload.movable.labels, sensor)
            scan = layered_scan(sweep, moving, sensor, options.layers == "movable", options.frame, turn)
        else:
            scan = scan_of(sweep, sensor, options.frame, turn)
        yield replace(scan, name=payload.entry.name, time=payload.time, frame_id=payload.frame_id)


def decode_groups(
    reader: ArchiveReader | Salvage,
    gops: Iterable[int],
    threads: int = 1,
    options: DecodeOptions = PLAIN,
) -> Iterator[Iterator[Scan]]:
    """Decode GOPs, one iterator of scans for each; with several threads, as many GOPs at once.

    Kernels run without the interpreter's lock, so threads are as good as processes, and no scan has to be copied. Then
    a GOP is decoded before its first scan is given, and up to ``threads`` more wait in memory. What comes is the same
    with any number; an iterator raises what :func:`decode_scans` does, after the same scans.
    """
    if threads <= 1:
        yield from (decode_scans(reader, gop, options) for gop in gops)
        return
    ahead: deque[Future[tuple[list[Scan], Exception | None]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for gop in gops:
                ahead.append(pool.submit(_decoded, reader, gop, options))
                if len(ahead) > threads:
                    yield _given(*ahead.popleft().result())
            while ahead:
                yield _given(*ahead.popleft().result())
        finally:
            for future in ahead:
                future.cancel()


def _decoded(
    reader: ArchiveReader | Salvage, gop: int, options: DecodeOptions
) -> tuple[list[Scan], Exception | None]:
    scans: list[Scan] = []
    try:
        scans.extend(decode_scans(reader, gop, options))  # keeps those before an error
    except Exception as error:  # noqa: BLE001 (whoever asks for the scan gets it)
        return scans, error
    return scans, None


def _given(scans: list[Scan], error: Exception | None) -> Iterator[Scan]:
    yield from scans
    if error is not None:
        raise error
