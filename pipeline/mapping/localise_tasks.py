"""What runs on a worker for ``localise``: the pairs of one stretch, registered in every way."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef, ShardRef, digest_of
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.report.schema import REGISTRATION
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.mapping.drive.deskew import deskewed, motion_of, turns_before
from salpcc.stages.mapping.drive.registration import METHODS, icp, rotation_error, translation_error
from salpcc.stages.mapping.gather import movable_of
from salpcc.stages.residual_code.archive.reader import ArchiveReader

VERSION = 3  # 3: raw scans de-skewed, too
_ROUNDS = 12  # of halving, to find the error at which a rival takes as many bits


@dataclass(frozen=True)
class Rival:
    """A baseline at the error at which it takes as many bits a point as an archive."""

    name: str
    max_error: float


@dataclass(frozen=True)
class Stretch:
    """Consecutive pairs of one sequence: names, places in the archives, source scans, true motions (16 numbers)."""

    sequence: str
    source: str
    archives: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    places: tuple[tuple[int, int], ...]
    refs: tuple[tuple[ScanRef, ScanRef], ...]
    steps: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, eq=False)
class _Cloud:
    """One way to have the scans: a name, what was asked, bits a point, and points with a mark of movable ones.

    ``movable`` is None where nobody knows.
    """

    cloud: str
    max_error: float | None
    bpp: float | None
    points: NDArray[np.float32]
    movable: NDArray[np.bool_] | None

    def registered(self, with_movable: bool) -> NDArray[np.float32]:
        """The points to register by."""
        return self.points if with_movable or self.movable is None else self.points[~self.movable]


def calibrate(archive: str, root: str, name: str) -> Rival:
    """Find the error at which a baseline takes as many bits a point as an archive, on the archive's first scan."""
    reader = ArchiveReader(archive)
    facts, entry = reader.facts, reader.gops[0][0]
    scans = SOURCES[facts.source].scans(Path(root), facts.sequence)
    ref = next(ref for ref in scans if ref.name == entry.name)
    scan = SOURCES[facts.source].read(ref, with_labels=False)
    rows = np.column_stack([scan.points, scan.intensity])
    wanted = _bits(reader)
    low, high = 1e-4, 2.0
    for _ in range(_ROUNDS):
        middle = float(np.sqrt(low * high))
        bits = 8 * len(BASELINES[name].encode(rows, middle)) / len(rows)
        low, high = (middle, high) if bits > wanted else (low, middle)
    return Rival(name, float(np.sqrt(low * high)))


def register_stretch(stretch: Stretch, rivals: Sequence[Rival], thin: int, out: Path) -> ShardRef:
    """Register the pairs of a stretch, unless its shard is there; the shard is a REGISTRATION table."""
    store = ShardStore(out)
    inputs = [ArchiveReader(path).facts.inputs for path in stretch.archives]
    digest = digest_of(VERSION, asdict(stretch), inputs, [asdict(rival) for rival in rivals], thin)
    ref = store.ref(stretch.sequence, "registration", stretch.places[0][0], digest)
    if store.found(ref) is not None:
        return ref
    opened = [(Archive(path), _bits(ArchiveReader(path))) for path in stretch.archives]
    first = opened[0][0]
    raw = all(first[place].motion is None for places in stretch.places for place in places)
    rows: list[dict[str, Any]] = []
    for pair, places, refs, step in zip(
        stretch.pairs, stretch.places, stretch.refs, stretch.steps, strict=True
    ):
        clouds = [
            [*_ours(opened, place), *_theirs(SOURCES[stretch.source].read(source, True), rivals)]
            for place, source in zip(places, refs, strict=True)
        ]
        truth = np.array(step).reshape(4, 4)
        if raw:
            clouds = [[*of, *(_deskewed(cloud, motion_of(truth, 1)) for cloud in of)] for of in clouds]
        known: dict[tuple[int, int, str], NDArray[np.float64]] = {}
        for before, after in zip(*clouds, strict=True):
            known_classes = before.movable is not None and after.movable is not None
            for movable in (True, False) if known_classes else (True,):
                target = before.registered(movable)
                source_points = after.registered(movable)[::thin]
                for title, method in METHODS.items():
                    # The same points give the same pose: what is bit-exact is registered once.
                    key = (zlib.crc32(target.tobytes()), zlib.crc32(source_points.tobytes()), method)
                    if key not in known:
                        known[key] = icp(source_points, target, method)
                    rows.append(
                        {
                            "sequence": stretch.sequence,
                            "source": pair[1],
                            "target": pair[0],
                            "cloud": before.cloud,
                            "max_error": before.max_error,
                            "movable": movable,
                            "method": title,
                            "rotation_deg": rotation_error(known[key], truth),
                            "translation_m": translation_error(known[key], truth),
                            "bpp": before.bpp,
                        }
                    )
    table = pa.Table.from_pylist(rows, schema=REGISTRATION)
    store.write(ref, table, {"stage": "registration", "stage_version": VERSION})
    return ref


def _ours(archives: Sequence[tuple[Archive, float]], place: int) -> Iterator[_Cloud]:
    for archive, bits in archives:
        scan = archive[place]
        config = archive.config
        cloud = str(config.get("profile", "sensor"))
        yield _Cloud(
            cloud,
            config.get("max_error") or 0.0,
            bits,
            scan.points,
            _known_movable(archive, scan),
        )


def _theirs(scan: Scan, rivals: Sequence[Rival]) -> Iterator[_Cloud]:
    """The source scan itself, and what comes back from each rival, movables coded apart to know them again."""
    movable = _movable(scan)
    yield _Cloud("source", None, None, scan.points, movable)
    rows = np.column_stack([scan.points, scan.intensity])
    for rival in rivals:
        codec = BASELINES[rival.name]
        parts = [rows[~movable], rows[movable]]
        data = [codec.encode(part, rival.max_error) if len(part) else b"" for part in parts]
        back = [codec.decode(piece)[:, :3] if piece else np.empty((0, 3), np.float32) for piece in data]
        marks = np.repeat([False, True], [len(part) for part in back])
        bits = 8 * sum(map(len, data)) / len(rows)
        yield _Cloud(rival.name, rival.max_error, bits, np.concatenate(back), marks)


def _deskewed(cloud: _Cloud, motion: NDArray[np.float64]) -> _Cloud:
    """Return a raw cloud as it is de-skewed by the true motion ``(6,)`` per turn."""
    before = turns_before(Scan("", cloud.points, np.empty(0, np.float32)))
    points = deskewed(cloud.points, before, motion).astype(np.float32)
    return replace(cloud, cloud=f"{cloud.cloud}, de-skewed", points=points)


def _known_movable(archive: Archive, scan: Scan) -> NDArray[np.bool_] | None:
    """Mark the points of a decoded scan that may move, None where nothing tells."""
    known = movable_of(scan)
    if known is not None:
        return known
    return None if archive.movable == "one layer" else np.zeros(len(scan), np.bool_)


def _movable(scan: Scan) -> NDArray[np.bool_]:
    assert scan.classes is not None
    return np.asarray(GROUP_OF_CLASS[scan.classes] == MOVABLE)


def _bits(reader: ArchiveReader) -> float:
    """Bits an input point of a whole archive file."""
    return 8 * reader.size / sum(entry.n_points for gop in reader.gops for entry in gop)
