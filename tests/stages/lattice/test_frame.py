"""Frames: the sensor frame of compensated scans is the raw scan; start and end are rigid motions of the recorded one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline import Archive, encode_scans
from salpcc.schemas.errors import UsageError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.frame import sweep_in_frame
from salpcc.stages.lattice.layers import both
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.lattice.untwist import twist
from salpcc.stages.segment.task import split

TURN = 10**8


def compensated(make_scan, seed: int):
    """A raw scan, and the same moved as KITTI moves it."""
    raw = make_scan(seed, stride=2, motion=None)
    motion = np.array([-1.2, 0.02, -0.01, 0.001, -0.002, 0.03])
    return raw, replace(raw, points=twist(raw.points.astype(np.float64), motion).astype(np.float32)), motion


def test_the_sensor_frame_is_the_raw_scan(make_scan, sensor) -> None:
    raw, scan, _ = compensated(make_scan, 3)
    sweep = scan_to_sweep(scan, sensor)
    assert sweep.motion is not None and len(sweep.laser) > 0.9 * len(scan)
    back = sweep_in_frame(sweep, sensor, "sensor", TURN)
    assert (back.points == raw.points).all(axis=1).mean() > 0.9999
    assert back.intensity.tobytes() == scan.intensity.tobytes() and back.offset is not None
    azimuth = np.arctan2(raw.points[:, 1], raw.points[:, 0]) / (2 * np.pi)
    off = np.abs((-back.offset / TURN - azimuth + 0.5) % 1 - 0.5)
    assert off.max() < 0.04  # a laser looks up to 11 degrees aside
    assert sweep_in_frame(sweep, sensor, "recorded", TURN).points.tobytes() == scan.points.tobytes()


def rotation(w: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(w)
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / angle
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@pytest.mark.parametrize(("frame", "s"), [("start", 0.5), ("end", -0.5)])
def test_start_and_end_are_where_the_sensor_was(make_scan, sensor, frame, s) -> None:
    _, scan, _ = compensated(make_scan, 4)
    sweep = scan_to_sweep(scan, sensor)
    assert sweep.motion is not None
    v, w = sweep.motion[:3], sweep.motion[3:]
    back = sweep_in_frame(sweep, sensor, frame, TURN)
    again = back.points.astype(np.float64) @ rotation(s * w).T + s * v
    assert np.abs(again - scan.points).max() < 2e-5
    if (
        frame == "start"
    ):  # what is measured as the turn begins, behind on the left, is in the place where it was measured
        first = sweep_in_frame(sweep, sensor, "sensor", TURN)
        early = np.asarray(first.offset) < -0.49 * TURN
        assert np.median(np.linalg.norm(first.points[early] - back.points[early], axis=1)) < 0.05


def test_layers_and_strays(make_scan, sensor) -> None:
    raw, scan, _ = compensated(make_scan, 5)
    points = scan.points.copy()
    points[::500] += np.float32(0.0003)
    points[7] = np.nan
    sweep = scan_to_sweep(replace(scan, points=points), sensor)
    whole = sweep_in_frame(sweep, sensor, "sensor", TURN)
    rng = np.random.default_rng(0)
    marks = rng.random(len(sweep.laser)) < 0.3, rng.random(len(sweep.stray_index)) < 0.5
    static, movable = split(sweep, sensor, *marks)
    movable = replace(movable, motion=static.motion)
    one = both(static, movable, sensor, lambda layer: sweep_in_frame(layer, sensor, "sensor", TURN))
    assert one.points.tobytes() == whole.points.tobytes() and (one.offset == whole.offset).all()
    assert np.isnan(whole.points[7]).all()
    finite = np.isfinite(points).all(axis=1)
    assert np.abs(whole.points - raw.points)[finite].max() < 0.002


def test_points_rounded_to_zero_keep_their_sign(make_scan, sensor) -> None:
    """Also those behind, where a turn ends with -0 and begins with 0; they are strays for that."""
    raw, _, motion = compensated(make_scan, 6)
    on = np.flatnonzero(np.abs(raw.points[:, 1]) < 0.02)
    points = raw.points.copy()
    points[on, 1] = -0.0
    s = np.where(points[:, 0] < 0, -0.5, 0.0)
    moved = twist(points.astype(np.float64), motion)
    m = motion
    from salpcc.stages.lattice.untwist import moved as move

    for i in on:
        moved[i] = move(float(points[i, 0]), -0.0, float(points[i, 2]), float(s[i]), tuple(m))
    scan = replace(raw, points=moved.astype(np.float32))
    back = sweep_in_frame(scan_to_sweep(scan, sensor), sensor, "sensor", TURN)
    assert (back.points[on] == points[on]).all(axis=1).mean() > 0.9
    behind = on[points[on, 0] < 0]
    assert len(behind) and np.signbit(back.points[behind, 1]).all()


def test_what_is_in_no_other_frame_is_refused(make_scan, sensor, tmp_path: Path) -> None:
    raw = make_scan(1, stride=8, motion=None)
    path = encode_scans([raw], tmp_path / "raw.mcap", effort="fast")
    with Archive.open(path, frame="sensor") as archive:
        (scan,) = archive
        assert scan.points.tobytes() == raw.points.tobytes() and scan.offset is not None
    for frame in ("start", "end"):
        with pytest.raises(UsageError, match=r"scan 0.* no motion"):
            list(Archive.open(path, frame=frame))  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    strays = replace(
        raw, points=rng.normal(0, 9, (300, 3)).astype(np.float32), intensity=raw.intensity[:300], classes=None
    )
    path = encode_scans([strays], tmp_path / "strays.mcap", effort="fast")
    with pytest.raises(UsageError, match="no motion"):
        list(Archive.open(path, frame="sensor"))
    with pytest.raises(UsageError, match="choose from"):
        Archive.open(path, frame="middle")  # type: ignore[arg-type]


def test_raw_twins_of_real_scans(real_data: Path, tmp_path: Path) -> None:
    """The sensor frame of KITTI's compensated scans equals KITTI's raw scans to the bit, signs of zeros included."""
    source = SOURCES["semantickitti"]
    refs = source.scans(real_data / "semantickitti", "07")[:3]
    scans = [source.read(ref, True) for ref in refs]
    options = {"labels": "given", "keep_movable": False, "effort": "fast"}
    path = encode_scans(scans, tmp_path / "07.mcap", "07", **options)
    with Archive.open(path, frame="sensor") as archive:
        for ref, scan, recorded in zip(refs, archive, scans, strict=True):
            twin = np.fromfile(
                real_data / f"kitti_raw/rtst_5/velodyne_points/data/{ref.number:010d}.bin", "<f4"
            ).reshape(-1, 4)
            same = (scan.points.view(np.uint32) == twin[:, :3].view(np.uint32)).all(axis=1)
            assert same.all(), f"{(~same).sum()} of {len(twin)} differ"
            assert (scan.movable == (GROUP_OF_CLASS[recorded.classes] == MOVABLE)).all()
            assert scan.offset is not None and np.ptp(scan.offset) > 0.09e9
    with Archive.open(path) as archive:
        assert archive[0].points.tobytes() == scans[0].points.tobytes() and archive[0].offset is None
