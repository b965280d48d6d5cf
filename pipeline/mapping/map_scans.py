"""The scans of a group as a map takes them: which layers, and classes of the network where it is asked."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from salpcc.pipeline.decode import DecodeOptions, Layers, decode_scans
from salpcc.pipeline.mapping.map_plan import Group
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.residual_code.archive.reader import ArchiveReader

VERSION = 2
WEIGHTS = "small"
_CLASSES = pa.schema([("class", pa.uint8())])


def unclassified(reader: ArchiveReader) -> bool:
    """Tell whether nothing in an archive says what may move."""
    return reader.movable == "one layer" and not reader.has_classes


def content_of(group: Group, config: MapConfig) -> list[int | str]:
    """Return what tells a group's scans from others: checksums of what will be decoded, and who says what they are."""
    reader, layers, asks = _opened(group, config)
    payloads = reader.payloads(group.gop)
    if layers == "all":
        payloads += reader.movable_payloads(group.gop)
    return [*(zlib.crc32(payload.data) for payload in payloads), "network" if asks else ""]


def scans_of(group: Group, config: MapConfig, store: ShardStore) -> Iterator[Scan]:
    """Decode the scans of a group, with the network's classes where the map asks for them and the archive has none.

    The network is asked once: its classes are kept in a shard.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
        WeightsError: the network's weights cannot be had.
    """
    reader, layers, asks = _opened(group, config)
    if not asks:
        yield from decode_scans(reader, group.gop, DecodeOptions(layers))
        return
    digest = digest_of(VERSION, content_of(group, config), group.names, WEIGHTS)
    ref = store.ref(group.sequence, "classes", group.number, digest)
    if store.found(ref) is None:
        _ask(group, reader, store, ref)
    classes, at = np.array(store.read(ref)[0].column("class")), 0
    for scan in decode_scans(reader, group.gop, DecodeOptions(layers)):
        yield replace(scan, classes=classes[at : at + len(scan)])
        at += len(scan)


def _ask(group: Group, reader: ArchiveReader, store: ShardStore, ref: ShardRef) -> None:
    from salpcc.stages.segment.labelling import joined, network_classes

    scans = list(decode_scans(reader, group.gop))
    found = network_classes(scans, joined(scans), [scan.motion for scan in scans], WEIGHTS)
    table = pa.table([pa.array(np.concatenate(found))], schema=_CLASSES)
    store.write(ref, table, {"stage": "classes", "stage_version": VERSION})


def _opened(group: Group, config: MapConfig) -> tuple[ArchiveReader, Layers, bool]:
    reader = ArchiveReader(Path(group.archive))
    parted = reader.movable == "layered" and config.layers == "static" and not config.keep_movable
    layers: Layers = "static" if parted else "all"
    return reader, layers, config.labels == "network" and not config.keep_movable and unclassified(reader)
