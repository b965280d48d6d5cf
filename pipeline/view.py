"""Look at scans: archives, logs and maps in the viewer of Rerun, with a time line, colours by what is known, and the path driven."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.against import Originals
from salpcc.pipeline.archive import Archive
from salpcc.pipeline.decode import Layers
from salpcc.pipeline.export.tell import Tell, in_silence
from salpcc.pipeline.held_poses import held_poses
from salpcc.pipeline.plan.plan import select
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic_file, read_at
from salpcc.schemas.labels import CLASSES, classes_of_labels
from salpcc.schemas.messages import COMPRESSED
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.mapping.drive.poses import inverse
from salpcc.stages.residual_code.archive.format import frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader

F64 = NDArray[np.float64]
Colours = NDArray[np.uint8]
_FOOTER = 64  # bytes at the end of a recording, in which Rerun marks that it is whole
_NONE: Mapping[str, F64] = MappingProxyType({})

_MOST_SECONDS = 10**8  # of a clock that counts from the start of a log; larger ones count from 1970
_HERE = "127.0.0.1"
_HEAD = 256  # bytes in which an archive has the type of its first channel
_MOST_TURNS = 5  # between scans, over which a motion is carried on
_PATH = (230, 60, 60)
_UNITS = {"height": " m", "intensity": "", "error": " mm"}
_STATIC, _MOVABLE = (150, 155, 165), (240, 120, 30)
# From dark to bright, evenly for the eye and for those who cannot tell red from green.
_RAMP = np.array(
    [(40, 30, 90), (50, 80, 150), (40, 130, 150), (60, 175, 125), (150, 205, 80), (245, 225, 70)], np.float64
)


@dataclass
class Palette:
    """Colours of points; what is darkest and brightest is settled by the first scan, so that none flickers."""

    limits: dict[str, tuple[float, float]] = field(default_factory=dict)

    def of(self, scan: Scan, errors: F64 | None = None) -> dict[str, Colours]:
        """Return, by what they tell, the colours ``(N, 3)`` of a scan's points; ``errors``: ``(N,)`` metres, where known."""
        found = {
            "height": self._ramp("height", scan.points[:, 2]),
            "intensity": self._ramp("intensity", scan.intensity),
        }
        if errors is not None:
            found["error"] = self._ramp("error", 1000 * errors)
        if (classes := _classes(scan)) is not None:
            found["class"] = np.array([c.colour for c in CLASSES], np.uint8)[classes]
        if scan.movable is not None:
            found["layer"] = np.array([_STATIC, _MOVABLE], np.uint8)[scan.movable.astype(np.intp)]
        return found

    def title(self, name: str) -> str:
        """Say what colours tell, and of a value what is darkest and what is brightest."""
        if name not in self.limits:
            return name
        low, high = (f"{limit:.3g}" for limit in self.limits[name])
        return f"{name} {low} to {high}{_UNITS[name]}"

    def _ramp(self, name: str, values: NDArray[Any]) -> Colours:
        if name not in self.limits:
            finite = values[np.isfinite(values)]
            low, high = np.percentile(finite, (2, 98)) if len(finite) else (0.0, 1.0)
            low = 0.0 if name == "error" else low
            self.limits[name] = float(low), max(float(high), float(low) + 1e-6)
        low, high = self.limits[name]
        place = np.clip(np.nan_to_num((values - low) / (high - low)), 0, 1) * (len(_RAMP) - 1)
        steps = np.arange(len(_RAMP))
        return np.column_stack([np.interp(place, steps, _RAMP[:, c]) for c in range(3)]).astype(np.uint8)


def _classes(scan: Scan) -> NDArray[np.uint8] | None:
    """The classes of a scan, or those of its labels where they are of SemanticKITTI."""
    if scan.classes is None and scan.labels is not None:
        with suppress(ValueError):  # labels of another kind
            return classes_of_labels(scan.labels)
    return scan.classes


def scans_of(path: Path, layers: Layers, frames: tuple[int, int] | None) -> Iterator[Scan]:
    """Yield the scans of an archive, a log, or a map's folder, of some frames only where asked.

    Raises:
        ArchiveError, SourceError: it cannot be read.
        UsageError: it is none of these, or none of its scans is of the frames.
    """
    if path.is_dir() and (path / "map.mcap").is_file():
        path = path / "map.mcap"
    if not path.exists():
        raise UsageError(f"{path}: not found; name an archive, a log or the folder of a map")
    if is_archive(path):
        yield from Archive.open(path, layers=layers).of_frames(frames)
        return
    names = Bag().sequences(path)
    if len(names) != 1:
        raise UsageError(f"{path}: no archive, log or folder of a map; of several logs name one")
    there = Bag().scans(path, names[0])
    chosen = select(there, frames)
    if not chosen:
        raise UsageError(f"{path}: no cloud of it is of these frames; it holds {len(there)}, counted from 0")
    for ref in chosen:
        yield Bag().read(ref, with_labels=False)


def is_archive(path: Path) -> bool:
    """Tell an archive from a log and from a folder."""
    return path.is_file() and COMPRESSED.encode() in read_at(path, 0, min(_HEAD, path.stat().st_size))


def step(motion: F64, turns: float) -> F64:
    """Return the pose ``(4, 4)`` of a scan ``turns`` turns on, in the frame of the scan before, by its own ``(v, w)``.

    The sensor turns against the azimuth by which ``(v, w)`` counts, hence the signs.
    """
    x, y, z = w = -turns * motion[3:]
    angle = np.linalg.norm(w)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] += np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
    pose[:3, 3] = -turns * motion[:3]
    return pose


class Drive:
    """Where the sensor was at each scan: by poses where they are known, else by the motions that scans carry; else at rest.

    Over a gap of many scans a motion says nothing: the drive goes on from where it was, and its path has a gap, too.
    """

    def __init__(self, poses: Mapping[str, F64] = _NONE) -> None:
        """Begin at the first scan; ``poses``: by the names of scans, in any frame."""
        self._poses = poses
        self._first: F64 | None = None  # of the poses, undone
        self.paths: list[list[F64]] = [[]]
        self.scans = 0
        self._pose: F64 = np.eye(4)
        self._number: int | None = None

    def at(self, scan: Scan) -> F64:
        """Return the pose ``(4, 4)`` of a scan in the frame of the first one; scans come in their order."""
        number = frame_number(scan.name, self.scans)
        turns = 0 if self._number is None else number - self._number
        if scan.name in self._poses:
            if self._first is None:
                self._first = self._pose @ inverse(self._poses[scan.name])
            self._pose = self._first @ self._poses[scan.name]
        elif turns > _MOST_TURNS:
            self.paths.append([])
        elif scan.motion is not None:
            self._pose = self._pose @ step(scan.motion, turns)
        self._number = number
        self.scans += 1
        self.paths[-1].append(self._pose[:3, 3].copy())
        return self._pose


def view(
    path: Path,
    layers: Layers = "all",
    frames: tuple[int, int] | None = None,
    against: Path | None = None,
    save: Path | None = None,
) -> int:
    """Show scans in a window of Rerun, or write them to ``save``, which it opens (FILE.rrd).

    Args:
        against: the source of an archive, from which the errors of its points are measured, and shown.

    Returns:
        the number of scans.

    Raises:
        UsageError, ArchiveError, SourceError: as in :func:`scans_of`; ``save`` is named otherwise, or ``against`` is no source of it.
        OSError: ``save`` cannot be written.
    """
    import rerun as rr

    if save is not None and save.suffix != ".rrd":  # it would take the place of an archive
        raise UsageError(f"{save}: a recording is a file NAME.rrd")
    reader = ArchiveReader(path) if is_archive(path) else None
    if reader is None and against is not None and path.exists():
        raise UsageError(f"{path}: only an archive has a source to be compared with")
    source = Originals(reader, against) if reader is not None and against is not None else None
    scans = ((scan, source.errors(scan) if source else None) for scan in scans_of(path, layers, frames))
    palette = Palette()
    first = next(scans)
    blueprint = _blueprint({name: palette.title(name) for name in palette.of(*first)})
    drive = Drive(_NONE if reader is None else held_poses(reader))
    rr.init(f"salpcc {path.stem}", spawn=save is None, default_blueprint=blueprint)
    with _recording(rr, save, blueprint):
        rr.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for scan, errors in chain([first], scans):
            _log(rr, scan, errors, drive, palette)
        paths = [np.array(path) for path in drive.paths if len(path) > 1]
        rr.log("path", rr.LineStrips3D(paths, colors=[_PATH] * len(paths), radii=0.08), static=True)
    return drive.scans


@contextmanager
def _recording(rr: Any, save: Path | None, blueprint: Any) -> Iterator[None]:
    """Have what is logged written to a file, where one is named, that appears when it is whole.

    Raises:
        OSError: it cannot be written.
    """
    if save is None:
        yield
        return
    with atomic_file(save) as part:
        part.open("wb").close()  # Rerun's own error says nothing of where
        try:
            rr.save(part, default_blueprint=blueprint)
            yield
        except RuntimeError as error:
            raise OSError(errno.EIO, str(error)) from error
        finally:
            rr.disconnect()  # writes what is still on its way to the file, and closes it
        with part.open("rb") as file:
            file.seek(-min(_FOOTER, part.stat().st_size), os.SEEK_END)
            if b"FOOT" not in file.read():  # a full disk, which Rerun does not raise
                raise OSError(errno.EIO, "Rerun could not write all of it; is there room?")


def view_in_browser(
    path: Path,
    layers: Layers = "all",
    frames: tuple[int, int] | None = None,
    against: Path | None = None,
    tell: Tell = in_silence,
) -> None:
    """Show scans in a browser until the process is interrupted; only this machine can reach them.

    Args:
        tell: is told how many scans there are, and the address.

    Raises:
        UsageError, ArchiveError, SourceError: as in :func:`view`.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{path.stem}.rrd"
        scans = view(path, layers, frames, against, file)
        data, page = _free_ports()
        tell(f"{scans} scans at http://{_HERE}:{page}?url=rerun%2Bhttp://{_HERE}:{data}/proxy until Ctrl-C")
        ports = ["--port", str(data), "--web-viewer-port", str(page)]
        serve = [sys.executable, "-m", "rerun", str(file), "--web-viewer", "--bind", _HERE, *ports]
        # A group of its own, that ends however this process is told to: Rerun's Python starts the server proper.
        with (
            _ends_when_terminated(),
            subprocess.Popen(serve, env={"RUST_LOG": "warn", **os.environ}, start_new_session=True) as server,
        ):
            try:
                if server.wait():
                    raise subprocess.CalledProcessError(server.returncode, serve)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(server.pid, signal.SIGTERM)


@contextmanager
def _ends_when_terminated() -> Iterator[None]:
    """Leave by an exception when SIGTERM comes, as Python does when Ctrl-C comes."""

    def leave(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _free_ports() -> list[int]:
    """Two ports that nobody uses: several viewers may be open."""
    with socket.socket() as first, socket.socket() as second:
        for each in (first, second):
            each.bind((_HERE, 0))
        return [each.getsockname()[1] for each in (first, second)]


def _log(rr: Any, scan: Scan, errors: F64 | None, drive: Drive, palette: Palette) -> None:
    seconds = scan.time / 1e9
    rr.set_time("scan", sequence=drive.scans)
    if seconds > _MOST_SECONDS:
        rr.set_time("time", timestamp=np.datetime64(scan.time, "ns"))
    else:
        rr.set_time("time", duration=seconds)
    pose = drive.at(scan)
    rr.log("sensor", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    there = np.isfinite(scan.points).all(axis=1)
    for name, colours in palette.of(scan, errors).items():
        rr.log(
            f"sensor/{name}",
            rr.Points3D(scan.points[there], colors=colours[there], radii=rr.Radius.ui_points(1.2)),
        )
    worst = "" if errors is None else f", largest error {1000 * errors.max(initial=0.0):.3g} mm"
    rr.log("name", rr.TextLog(f"{scan.name}: {len(scan):,} points{worst}"))


def _blueprint(titles: dict[str, str]) -> Any:
    """One tab a colouring, under its title, all of the same place."""
    import rerun.blueprint as rrb

    views = [
        rrb.Spatial3DView(origin="/", name=title, contents=["/path", "/sensor", f"/sensor/{name}"])
        for name, title in titles.items()
    ]
    return rrb.Blueprint(rrb.Tabs(*views), rrb.TimePanel(state="collapsed"), collapse_panels=True)
