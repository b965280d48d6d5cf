"""The main job on real scans: what goes in comes out, byte for byte, and at the price that was promised."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

COMMAND = [sys.executable, "-m", "salpcc.pipeline.cli"]


def cli(*arguments: object) -> str:
    result = subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_semantickitti_comes_back_byte_for_byte(real_data: Path, tmp_path: Path) -> None:
    root = real_data / "semantickitti"
    run = ["run", "sequences", "00,07", "--root", root, "--out", tmp_path, "--keep-movable", "--json"]
    report = json.loads(cli(*run, "--workers", 1))
    for sequence, scans in (("00", 6), ("07", 7)):
        figures = report["sequences"][sequence]
        assert figures["bit_exact_scans"] == figures["frames"] == scans
        assert figures["bpp"]["geometry"] < 7.7 and figures["bpp"]["intensity"] < 4.6
        assert figures["points_on_fallback"] < 1e-3 * figures["points_in"]
        assert 0.99 * figures["points_in"] < figures["points_bit_identical"] < figures["points_in"]
        assert figures["points_decoded"] == figures["points_in"]
        cli("decode", tmp_path / "archives" / f"{sequence}.mcap", "--to", "kitti", "--out", tmp_path / "back")
        for path in (root / "sequences" / sequence / "velodyne").glob("*.bin"):
            back = tmp_path / "back" / "sequences" / sequence / "velodyne" / path.name
            assert back.read_bytes() == path.read_bytes()
    assert report["run"]["worker_peak_mb"] < 1500


def test_raw_drives_come_back_byte_for_byte(real_data: Path, tmp_path: Path) -> None:
    root = real_data / "kitti_raw"
    run = ["run", "sequences", "rtst_5,single", "--source", "kitti_raw", "--root", root, "--out", tmp_path]
    cli(*run, "--keep-movable", "--workers", 1)
    for sequence, folder in (("rtst_5", "rtst_5/velodyne_points/data"), ("single", "single")):
        verdict = json.loads(
            cli("verify", tmp_path / "archives" / f"{sequence}.mcap", "--against", root, "--json")
        )
        assert verdict["bit_exact_scans"] == len(list((root / folder).glob("*.bin"))) == verdict["scans"]


@pytest.mark.parametrize("bound", [0.005, 0.01, 0.02])
def test_no_point_is_farther_than_asked(real_data: Path, tmp_path: Path, bound: float) -> None:
    root = real_data / "semantickitti"
    run = ["run", "sequences", "04", "--root", root, "--out", tmp_path, "--keep-movable", "--frames", "0:2"]
    cli(*run, "--max-error", bound, "--workers", 0)
    cli("decode", tmp_path / "archives" / "04.mcap", "--to", "kitti", "--out", tmp_path)
    for name in ("000000", "000001"):
        source = np.fromfile(root / "sequences/04/velodyne" / f"{name}.bin", "<f4").reshape(-1, 4)
        back = np.fromfile(tmp_path / "sequences/04/velodyne" / f"{name}.bin", "<f4").reshape(-1, 4)
        distance = np.linalg.norm(source[:, :3].astype(float) - back[:, :3].astype(float), axis=1)
        assert 0 < distance.max() <= bound
        assert (source[:, 3] == back[:, 3]).all()


def test_odd_scans_are_coded_or_refused_and_nothing_else_is_lost(real_data: Path, tmp_path: Path) -> None:
    root, folder = tmp_path / "root", tmp_path / "root/sequences/00/velodyne"
    folder.mkdir(parents=True)
    good = (real_data / "semantickitti/sequences/00/velodyne/000000.bin").read_bytes()
    rows = np.frombuffer(good, "<f4").reshape(-1, 4)
    odd = rows.copy()
    odd[5, 0], odd[7, :3], odd[100:120] = np.nan, np.inf, odd[99]
    foreign = np.fromfile(real_data / "other_sensors/nuscenes_lidar_top.pcd.bin", "<f4").reshape(-1, 5)[:, :4]
    scans = [good, b"", odd.tobytes(), rows[:10].tobytes(), foreign.tobytes(), good[:1000001], good]
    for number, data in enumerate(scans):
        (folder / f"{number:06d}.bin").write_bytes(data)
    run = [
        *COMMAND,
        "run",
        "sequences",
        "00",
        "--root",
        root,
        "--out",
        tmp_path / "out",
        "--keep-movable",
        "--json",
    ]
    result = subprocess.run([*run, "--workers", "0"], capture_output=True, text=True, check=False)
    assert result.returncode == 1 and "Traceback" not in result.stderr
    report = json.loads(result.stdout)
    assert [error["scan"] for error in report["errors"]] == ["000005"]
    figures = report["sequences"]["00"]
    assert figures["frames"] == figures["bit_exact_scans"] == 6
    assert figures["points_on_fallback"] >= len(foreign)
    cli("decode", tmp_path / "out/archives/00.mcap", "--to", "kitti", "--out", tmp_path / "back")
    for number in (0, 1, 2, 3, 4, 6):
        assert (tmp_path / "back/sequences/00/velodyne" / f"{number:06d}.bin").read_bytes() == scans[number]
