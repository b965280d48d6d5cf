"""Take what may move out of an archive, or some of it; the static layer is copied, never decoded for it, and its bytes prove that.

Where only some goes, the movable chunks that held it are coded anew; all other chunks stay as they are.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.edit.cut import check_new
from salpcc.pipeline.held_poses import unpacked_poses
from salpcc.schemas.errors import ArchiveError, SourceError, UsageError
from salpcc.schemas.files import there, write_json
from salpcc.schemas.labels import CLASSES, MOVABLE, known_classes
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.schemas.version import TOOL
from salpcc.stages.lattice.layers import alone, movable_mask, placed
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import source_places, sweep_to_scan
from salpcc.stages.mapping.drive.poses import move, poses_of, read_poses
from salpcc.stages.residual_code.archive.format import ScanEntry, ScanPayload, frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.label_coder import encode_labels, labelled
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan
from salpcc.stages.segment.task import keep

VERSION = 1
_UNFIT = "labels/"  # side files that hold labels which belong to no point, so nobody knows of what they tell


@dataclass(frozen=True)
class Selection:
    """Which movable points go: all by default; else those that meet all of what is given.

    A scan's frame number is its name where that is a number, else its place.

    Attributes:
        frames: of frames ``[first, last)``.
        classes: of some classes, by the labels where no classes are stored.
        box: within x0, y0, z0, x1, y1, z1, metres in the frame of the poses.
    """

    frames: tuple[int, int] | None = None
    classes: tuple[str, ...] = ()
    box: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.box and not (
            len(self.box) == 6 and all(a < b for a, b in zip(self.box, self.box[3:], strict=False))
        ):
            raise UsageError(
                f"box {','.join(f'{v:g}' for v in self.box)}: six numbers x0,y0,z0,x1,y1,z1, the first three the lower ones"
            )
        known = {c.name for c in CLASSES if c.group == MOVABLE}
        if unknown := sorted(set(self.classes) - known):
            raise UsageError(f"class {unknown[0]}: choose from {', '.join(sorted(known))}")

    @property
    def whole(self) -> bool:
        """Tell whether everything goes."""
        return self.frames is None and not self.classes and not self.box

    def concerns(self, name: str, place: int) -> bool:
        """Tell whether points of a scan may go."""
        return self.frames is None or self.frames[0] <= frame_number(name, place) < self.frames[1]

    def gone(self, scan: Scan, pose: NDArray[np.float64] | None) -> NDArray[np.bool_]:
        """Mark which points ``(M,)`` of the movable layer of a scan that it concerns go.

        Args:
            pose: of the scan, sensor to map ``(4, 4)``; with a box.
        """
        gone = np.ones(len(scan), np.bool_)
        if self.classes:
            classes = (
                scan.classes
                if scan.labels is None or scan.classes is not None
                else known_classes(scan.labels)
            )
            assert classes is not None
            gone &= np.isin(classes, [i for i, c in enumerate(CLASSES) if c.name in self.classes])
        if self.box and pose is not None:
            placed = move(scan.points, pose)
            with np.errstate(invalid="ignore"):
                outside = (placed < self.box[:3]) | (placed > self.box[3:])
            gone &= ~outside.any(axis=1)  # of a point without a place nobody knows that it lies outside
        return gone


def redact(
    path: Path, out: Path, selection: Selection | None = None, poses: Path | None = None
) -> dict[str, Any]:
    """Write to ``out`` the archive ``path`` without what may move, and beside it the manifest ``OUT.json``; return that.

    The manifest has the SHA-256 of each chunk of coded scans as it was in ``path``, and of the movable ones that are left.

    Args:
        poses: KITTI's, with the ``calib.txt`` beside them, for a box; None takes those that the archive holds.

    Raises:
        UsageError: ``out`` or its manifest exists; the archive has no movable layer, no scan of the frames, or no
            classes or poses to choose by.
        SourceError: the poses are not those of the scans.
        ArchiveError: the archive is damaged.
    """
    selection = selection or Selection()
    check_new(out)
    if there(beside := manifest_path(out)):
        raise UsageError(f"{beside}: exists, and the manifest has this name; name another --out")
    reader = ArchiveReader(path)
    if reader.movable != "layered":
        what = "was dropped" if reader.movable == "dropped" else "is in one layer with the rest"
        raise UsageError(f"{path}: has no movable layer to take out; what may move {what}")
    if selection.classes and not any(e.classes or e.labels for gop in reader.movable_gops for e in gop):
        raise UsageError(
            f"{path}: no classes are stored in it; it can be redacted as a whole, by --frames or by --box"
        )
    names = reader.names
    if names and not any(selection.concerns(name, place) for place, name in enumerate(names)):
        raise UsageError(f"{path}: no scan of it is of these frames; {reader.held}")
    placed = _poses(reader, poses) if selection.box else None
    reader.check()
    # Without its inputs no run takes it for the archive that it would make.
    facts = replace(reader.facts, inputs="")
    log = PassingLog(reader.log.values(), reader.passing(), reader.enclosed()) if reader.log else None
    side = (reader.side_file(name) for name in reader.side if not name.startswith(_UNFIT))
    write_archive(out, facts, _gops(reader, selection, placed), log, side)
    manifest = {"version": VERSION, "tool": TOOL, "redacted": _told(selection)} | chunk_hashes(reader)
    manifest["left"] = chunk_hashes(ArchiveReader(out))["movable"]
    write_json(beside, manifest)
    return manifest


def manifest_path(out: Path) -> Path:
    """Where the manifest of a redacted archive lies."""
    return out.with_name(f"{out.stem}.json")


def chunk_hashes(reader: ArchiveReader) -> dict[str, Any]:
    """Return the SHA-256 of each chunk of coded scans, by layer, with its GOP."""
    found: dict[str, Any] = {"archive": reader.path.name, "sequence": reader.facts.sequence}
    found |= {"static": [], "movable": []}
    for layer, gop, chunk in reader.layer_chunks():
        digest = hashlib.sha256(reader.chunk_bytes(chunk)).hexdigest()
        found[layer].append({"gop": gop, "sha256": digest})
    return found


def check_redacted(reader: ArchiveReader, manifest: Path) -> list[str]:
    """Say what is wrong with an archive as the redaction of that which a manifest tells of; nothing, if nothing is.

    Its static chunks must be the very bytes that they were, its movable ones those that the redaction left.

    Raises:
        UsageError: the manifest cannot be read.
    """
    try:
        old = json.loads(manifest.read_bytes())
        static = [(row["gop"], row["sha256"]) for row in old["static"]]
        all_of_it = old["redacted"] == _told(Selection())
        # Where all went, a manifest says no more.
        left = [] if all_of_it else [(row["gop"], row["sha256"]) for row in old["left"]]
        sequence = old["sequence"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{manifest}: no manifest of a redaction ({error})") from error
    new = chunk_hashes(reader)
    problems = []
    if new["sequence"] != sequence:
        problems.append(f"is of sequence {new['sequence']}, the manifest of {sequence}")
    for layer, old_chunks in ("static", static), ("movable", left):
        here = [(row["gop"], row["sha256"]) for row in new[layer]]
        if all_of_it and layer == "movable" and here:
            problems.append(f"{len(here)} movable chunks are still there")
        elif here != old_chunks:
            differ = sorted({gop for gop, _ in set(here) ^ set(old_chunks)})
            problems.append(f"{layer} chunks differ: those of GOP {', '.join(map(str, differ))}")
    return problems


def _told(selection: Selection) -> dict[str, Any]:
    return {
        "frames": list(selection.frames) if selection.frames else None,
        "classes": list(selection.classes),
    } | ({"box": list(selection.box)} if selection.box else {})


def _poses(reader: ArchiveReader, given: Path | None) -> NDArray[np.float64]:
    """The poses of the scans, sensor to map ``(n, 4, 4)``."""
    names = reader.names
    if given is not None:
        try:
            return poses_of(names, read_poses(given), given)
        except SourceError as error:
            raise _no_poses(str(error)) from error
    with unpacked_poses(reader) as path:
        if path is None:
            raise UsageError(
                f"{reader.path}: it holds no poses.txt and calib.txt; name the poses with --poses"
            )
        try:
            return poses_of(names, read_poses(path), path)
        except SourceError as error:
            what = str(error).replace(f"{path.parent}/", "side file ")
            raise _no_poses(f"{reader.path}: {what}") from error


def _no_poses(what: str) -> SourceError:
    """An error of poses, with the remedy that a box has; others can do with odometry."""
    return SourceError(f"{what.partition(';')[0]}; name the poses of its scans with --poses FILE")


_Poses = NDArray[np.float64] | None  # of all scans, or of those of a GOP


def _gops(reader: ArchiveReader, selection: Selection, poses: _Poses) -> Iterator[list[ScanPayload]]:
    place = 0
    for gop in range(len(reader.gops)):
        payloads = reader.payloads(gop)
        if selection.whole:
            yield payloads
            continue
        layers = reader.movable_payloads(gop)
        concerned = [selection.concerns(p.entry.name, place + at) for at, p in enumerate(payloads)]
        here = None if poses is None else poses[place : place + len(payloads)]
        place += len(payloads)
        if any(concerned):
            layers = _coded_anew(reader, payloads, layers, concerned, selection, here)
        yield [replace(p, movable=layer) for p, layer in zip(payloads, layers, strict=False)] + payloads[
            len(layers) :
        ]


def _coded_anew(
    reader: ArchiveReader,
    payloads: list[ScanPayload],
    layers: list[ScanPayload],
    concerned: list[bool],
    selection: Selection,
    poses: _Poses,
) -> list[ScanPayload]:
    """Code the movable layers of a GOP again without what goes of the scans that are concerned; as they are if nothing goes."""
    sensor = reader.facts.sensor
    state = GopState(sensor)
    pairs: list[tuple[Sweep, Sweep]] = []
    statics = decode_gop((payload.data for payload in payloads), sensor)
    left = 0
    for at, (layer, static, some) in enumerate(zip(layers, statics, concerned, strict=False)):
        movable = labelled(decode_scan(layer.data, sensor, state, static), layer.labels, sensor)
        if some:
            pose = None if poses is None else poses[at]
            movable = _without(static, movable, sensor, selection, pose)
        pairs.append((static, movable))
        left += len(movable)
    if left == sum(layer.entry.kept for layer in layers):
        return layers
    effort = str(reader.facts.config.get("effort", "default"))
    coded = []
    again = encode_gop((m for _, m in pairs), sensor, effort, statics=(static for static, _ in pairs))
    for layer, (_, movable), payload in zip(layers, pairs, again, strict=True):
        labels = encode_labels(movable, sensor) if movable.labels is not None else b""
        entry = ScanEntry(
            layer.entry.name, movable.n_points, len(movable), 0, len(movable.stray_index), **payload.sizes,
            labels=len(labels),
        )  # fmt: skip
        coded.append(replace(layer, entry=entry, data=payload.data, labels=labels))
    return coded


def _without(static: Sweep, movable: Sweep, sensor: SensorModel, selection: Selection, pose: _Poses) -> Sweep:
    """Return a movable layer without what goes."""
    mask = movable_mask(static, movable, sensor)
    listed = alone(movable, mask)
    gone = selection.gone(sweep_to_scan(listed, sensor), pose)
    if not gone.any():
        return movable
    on, off = source_places(listed, sensor)
    left = mask.copy()
    left[np.flatnonzero(mask)[gone]] = False
    rest = keep(listed, sensor, ~gone[on], ~gone[off])
    if rest.cloud is not None:
        rest = replace(rest, cloud=replace(rest.cloud, loose=b"") if len(rest) else None)
    return placed(rest, static, left[left | ~mask])


def describe(manifest: dict[str, Any], reader: ArchiveReader) -> str:
    """Say in a line what became of the chunks.

    Raises:
        ArchiveError: the static chunks are not what they were; that is a fault of this tool.
    """
    new = chunk_hashes(reader)
    if new["static"] != manifest["static"]:
        raise ArchiveError(f"{reader.path}: static chunks are not those of {manifest['archive']}")
    kept = sum(row in manifest["movable"] for row in new["movable"])
    anew = len(new["movable"]) - kept
    return (
        f"{len(new['static'])} static chunks as they were; of {len(manifest['movable'])} movable chunks "
        f"{kept} as they were, {anew} coded anew, {len(manifest['movable']) - len(new['movable'])} gone"
    )
