"""Payloads of both profiles: a checksum, then kernels. What decodes must be the very same scan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from mutate import mutate_payload
from target import Target, Wrong

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import GridSweep
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.ground_fit.grid_planes import fit_ground
from salpcc.stages.ingest.paper_grid import row_elevations, scan_to_grid
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.layers import movable_mask
from salpcc.stages.lattice.list_motion import places, redo
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.list_coder import decode_list
from salpcc.stages.predict.paper.frames import predict_gop
from salpcc.stages.residual_code.gop import decode_any, decode_gop, encode_gop, encode_layers
from salpcc.stages.residual_code.label_coder import decode_labels, encode_labels
from salpcc.stages.residual_code.paper import grid_header
from salpcc.stages.residual_code.paper.grid_coder import encode_grid
from salpcc.stages.residual_code.paper.grid_images import IMAGE_CODERS
from salpcc.stages.residual_code.paper.grid_streams import GridState
from salpcc.stages.residual_code.sensor import header
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan
from salpcc.stages.segment.task import quantise, split

SENSOR, PANDAR = load_sensor("hdl64e"), load_sensor("pandar64")
TOLD = Path(__file__).parents[1] / "golden" / "told"
_crcs: dict[Path, list[int]] = {}


def small_scan(sensor: SensorModel, rng: np.random.Generator) -> Scan:
    """A room of a few thousand returns, with strays."""
    firings = np.arange(0, sensor.ticks_per_turn, 40)
    laser = np.repeat(np.arange(sensor.n_lasers), len(firings))
    tick = (np.tile(firings, sensor.n_lasers) + sensor.shift[laser]) % sensor.ticks_per_turn
    count = (3000 + 500 * np.sin(tick / 200) + rng.normal(0, 5, len(tick))).astype(np.int32)
    model = unproject(sensor, laser.astype(np.uint8), tick.astype(np.int32), count)
    order = np.lexsort((azimuth_keys(model), laser))
    points = (np.rint(model[order] * 1000) / 1000).astype(np.float32)
    points[:20] = rng.normal(0, 5, (20, 3))
    return Scan("0", points, (rng.integers(0, 101, len(points)) / 100).astype(np.float32), classes=None)


def _sensor_profile(folder: Path) -> list[bytes]:
    sweep = scan_to_sweep(small_scan(SENSOR, np.random.default_rng(0)), SENSOR)
    tasks = [(task, effort) for task in (sweep, quantise(sweep, SENSOR, 0.01)) for effort in header.EFFORTS]
    _crcs[folder] = [header.content_crc(task) for task, _ in tasks]
    return [encode_gop([task], SENSOR, effort)[0].data for task, effort in tasks]


def _other_sensor() -> SensorModel:
    """Sixteen lasers that no network knows."""
    none = np.zeros(16)
    theta = np.radians(np.linspace(15, -15, 16))
    return SensorModel("fan", 3600, 0.002, theta, none, none, none, none, np.zeros(16, np.int64))


OTHER = _other_sensor()


def _aimed(folder: Path) -> list[bytes]:
    """Firings of another sensor, not rounded to 1 mm: exact, within a bound, and moved; some points off the lattice."""
    rng = np.random.default_rng(0)
    laser, tick = np.tile(np.arange(16), 60), np.repeat(np.arange(0, 3600, 60), 16)
    count = (3000 + 500 * np.sin(tick / 200) + rng.normal(0, 5, len(tick))).astype(np.int32)
    points = unproject(OTHER, laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    points[::50] = rng.normal(0, 5, points[::50].shape)
    points[7::60] = 0
    intensity = (rng.integers(0, 101, len(points)) / 100).astype(np.float32)
    motion = np.array([-0.3, 0, 0, 0, 0, 1e-3])
    moved = redo(points.astype(np.float64), places(len(points), 16), motion).astype(np.float32)
    sweeps = [scan_to_sweep(Scan("0", p, intensity), OTHER) for p in (points, moved)]
    sweeps[1] = replace(sweeps[1], motion=motion)
    pairs = [(sweep, quantise(sweep, OTHER, 0.01)) for sweep in sweeps]
    tasks = [(task, effort) for pair in pairs for task in pair for effort in ("fast", "default")]
    _crcs[folder] = [header.content_crc(task) for task, _ in tasks]
    return [encode_gop([task], OTHER, effort)[0].data for task, effort in tasks]


def _read_aimed(which: int, data: bytes, folder: Path) -> None:
    for back in decode_any([data], OTHER):
        if isinstance(back, GridSweep) or header.content_crc(back) != _crcs[folder][which]:
            raise Wrong("a payload decoded to another scan")


def _paper_profile(folder: Path) -> list[bytes]:
    scan = small_scan(SENSOR, np.random.default_rng(0))
    grid = scan_to_grid(scan, 0.02, row_elevations([scan.points]))
    _crcs[folder] = [grid_header.content_crc(grid)] * len(IMAGE_CODERS)
    (predicted,) = predict_gop([grid])
    return [encode_grid(grid, fit_ground(grid), predicted, GridState(coder)).data for coder in IMAGE_CODERS]


def _read(which: int, data: bytes, folder: Path) -> None:
    for back in decode_any([data], SENSOR):
        crc = grid_header.content_crc if isinstance(back, GridSweep) else header.content_crc
        if crc(back) != _crcs[folder][which]:
            raise Wrong("a payload decoded to another scan")


_statics: dict[Path, list[Sweep]] = {}


def _labelled() -> Sweep:
    """A room of which a third may move, with labels in runs and some of their own."""
    sweep = scan_to_sweep(small_scan(SENSOR, np.random.default_rng(0)), SENSOR)
    rng = np.random.default_rng(1)
    runs = np.repeat(rng.choice(np.array([10, 40, 50 | 3 << 16], np.uint32), len(sweep)), 30)[: len(sweep)]
    runs[::700] = rng.integers(0, 2**32, len(runs[::700]), np.uint32)
    on, off = np.split(runs, [len(sweep.laser)])
    return replace(sweep, labels=on, stray_labels=off)


def _parts(bounds: tuple[float | None, float | None]) -> tuple[Sweep, Sweep]:
    sweep = _labelled()
    assert sweep.labels is not None and sweep.stray_labels is not None
    return split(sweep, SENSOR, sweep.labels == 10, sweep.stray_labels == 10, bounds)


def _movable_layers(folder: Path) -> list[bytes]:
    pairs = [
        (_parts(bounds), effort) for bounds in ((None, None), (0.02, 0.005)) for effort in header.EFFORTS
    ]
    _crcs[folder] = [header.content_crc(movable) for (_, movable), _ in pairs]
    coded = [encode_layers([pair], SENSOR, effort)[0] for pair, effort in pairs]
    _statics[folder] = [next(decode_gop([static.data], SENSOR)) for static, _ in coded]
    return [movable.data for _, movable in coded]


def _read_movable(which: int, data: bytes, folder: Path) -> None:
    static = _statics[folder][which]
    back = decode_scan(data, SENSOR, GopState(SENSOR), static)
    movable_mask(static, back, SENSOR)
    if header.content_crc(back) != _crcs[folder][which]:
        raise Wrong("a movable layer decoded to another one")


def _labels(folder: Path) -> list[bytes]:
    plain = _labelled()
    assert plain.labels is not None and plain.stray_labels is not None
    of = [(labels % 5).astype(np.uint8) for labels in (plain.labels, plain.stray_labels)]
    classes = replace(plain, classes=of[0], stray_classes=of[1])
    _statics[folder] = [plain, classes, *_parts((None, None)), *_parts((0.02, 0.02))]
    return [encode_labels(sweep, SENSOR) for sweep in _statics[folder]]


def _read_labels(which: int, data: bytes, folder: Path) -> None:
    sweep = _statics[folder][which]
    on, off = decode_labels(data, sweep, SENSOR)
    if not (np.array_equal(on, sweep.labels) and np.array_equal(off, sweep.stray_labels)):
        raise Wrong("labels decoded to others")


# Golden streams of strays whose lasers and times are told, and of learned ones, each after the one that it goes on from.
_TOLD = (
    ("moved",), ("timed",), ("learned_0",), ("learned_0", "learned_1"), ("shuffled_0",), ("shuffled_0", "shuffled_1"),
    ("passed_0", "passed_1"), ("rays_0",), ("rays_0", "rays_1"), ("angled",),
)  # fmt: skip


def _told(folder: Path) -> list[bytes]:
    return [(TOLD / f"{names[-1]}.bin").read_bytes() for names in _TOLD]


def _read_told(which: int, data: bytes, folder: Path) -> None:
    expected = json.loads((TOLD / "expected.json").read_text())
    lists, names = LearnedLists(), _TOLD[which]
    whole = [(TOLD / f"{name}.bin").read_bytes() for name in names[:-1]]
    for name, stream in zip(names, [*whole, data], strict=True):
        kind, _, place = name.partition("_")
        known = expected["learned" if kind == "shuffled" else kind]
        n = known[int(place)][0] if place else known[0] if kind == "angled" else expected["n"]
        *_, sound = decode_list(n, 0.0, np.frombuffer(bytearray(stream), np.uint8), PANDAR, lists=lists)
    if not sound:  # what is sound and other than it was, the checksum of its payload finds
        raise ArchiveError("stray points do not decode")


TARGETS = {
    "payload": Target(_sensor_profile, _read, 0.4, mutate_payload),
    "payload of another sensor": Target(_aimed, _read_aimed, 0.1, mutate_payload),
    "payload of a movable layer": Target(_movable_layers, _read_movable, 0.1, mutate_payload),
    "labels": Target(_labels, _read_labels, 0.1, mutate_payload),
    "strays that are told": Target(_told, _read_told, 0.05),
    "payload of the paper profile": Target(_paper_profile, _read, 0.04, mutate_payload),
}
