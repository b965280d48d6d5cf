"""Folders of scans as people have them: what cannot be told for sure is refused, never guessed."""

from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.velodyne_bin import looks_wide
from salpcc.stages.mapping.drive.poses import poses_of, read_poses

SECOND = 1_000_000_000


def sequence(root: Path, frames: list[int | str], times: str | None = None) -> Path:
    """Lay out ``root/sequences/00`` with empty scans; returns its folder of scans."""
    folder = root / "sequences" / "00" / "velodyne"
    folder.mkdir(parents=True)
    for frame in frames:
        (folder / (frame if isinstance(frame, str) else f"{frame:06d}.bin")).write_bytes(bytes(16))
    if times is not None:
        (folder.parent / "times.txt").write_bytes(times.encode())
    return folder


def times_of(root: Path, source: str = "semantickitti", name: str = "00") -> list[float]:
    return [ref.time / SECOND for ref in SOURCES[source].scans(root, name)]


@pytest.mark.parametrize(
    ("text", "frames", "expected"),
    [
        ("0.0\n0.1\n\n0.3\n", [0, 1, 3], [0.0, 0.1, 0.3]),  # a blank line keeps its place
        ("\ufeff0.0\r\n1.0e-1\r\n2.0e-1\r\n", [0, 1, 2], [0.0, 0.1, 0.2]),  # byte order mark, Windows
        ("0.0\n0.1\n0.2\n0.3\n\n\n", [1, 3], [0.1, 0.3]),  # longer than the scans
        ("1700000000.0\n1700000000.1\n", [0, 1], [1700000000.0, 1700000000.1]),
    ],
)
def test_each_frame_has_the_time_of_its_line(
    tmp_path: Path, text: str, frames: list[int | str], expected: list[float]
) -> None:
    sequence(tmp_path, frames, text)
    assert times_of(tmp_path) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "frames", "said"),
    [
        ("0.0\n0.1\n\n0.3\n", [0, 1, 2, 3], r"times\.txt: no time for frame 2"),
        ("1700000000.0\n1700000000.1\n", [0, 1, 2], r"no time for frame 2.*000002\.bin"),
        ("", [0], "no time for frame 0"),
        ("0 0.0\n1 0.1\n", [0, 1], "line 1, '0 0.0', is not one number"),
        ("0.0 0.1 0.2\n", [0, 1, 2], "line 1"),
        ("0.0\nsoon\n", [0, 1], "line 2, 'soon'"),
        ("0.0\n0.1\n", ["a.bin", "b.bin", "c.bin"], "2 lines for 3 scans"),
    ],
)
def test_times_that_say_too_little_are_refused(
    tmp_path: Path, text: str, frames: list[int | str], said: str
) -> None:
    sequence(tmp_path, frames, text)
    with pytest.raises(SourceError, match=said):
        times_of(tmp_path)


def test_blank_lines_of_raw_drives_keep_their_place(tmp_path: Path) -> None:
    """KITTI's own timestamps.txt has blank lines where scans are missing."""
    folder = tmp_path / "drive" / "velodyne_points" / "data"
    folder.mkdir(parents=True)
    lines = [f"2011-01-01 13:00:0{i}.{i}00000000" if i not in (3, 4) else "" for i in range(8)]
    (folder.parent / "timestamps.txt").write_text("\n".join(lines) + "\n")
    for i in (0, 1, 2, 5, 6, 7):
        (folder / f"{i:010d}.bin").write_bytes(bytes(16))
    assert times_of(tmp_path, "kitti_raw", "drive") == pytest.approx([0, 1.1, 2.2, 5.5, 6.6, 7.7])
    (folder / "0000000003.bin").write_bytes(bytes(16))
    with pytest.raises(SourceError, match=r"timestamps\.txt: no time for frame 3"):
        times_of(tmp_path, "kitti_raw", "drive")


def test_hidden_files_are_no_scans(tmp_path: Path) -> None:
    folder = sequence(tmp_path, [0, 1], "0.5\n0.6\n")
    for name in ("._000000.bin", "._000001.bin", ".000002.bin"):
        (folder / name).write_bytes(bytes(4096))
    (tmp_path / "sequences" / "._00" / "velodyne").mkdir(parents=True)
    assert times_of(tmp_path) == [0.5, 0.6]
    assert SOURCES["semantickitti"].sequences(tmp_path) == ["00"]
    assert SOURCES["kitti_raw"].sequences(tmp_path / "sequences" / "00") == ["velodyne"]


@pytest.mark.parametrize(
    ("frames", "said"), [([0, 1, "average.bin"], r"average\.bin"), ([0, "0.bin"], "two scans of one frame")]
)
def test_frames_that_cannot_be_told_are_refused(tmp_path: Path, frames: list[int | str], said: str) -> None:
    sequence(tmp_path, frames)
    with pytest.raises(SourceError, match=said):
        times_of(tmp_path)


def test_blank_lines_of_poses_keep_their_place(tmp_path: Path) -> None:
    """The pose of frame 2 is that of line 3, whatever stands before it."""
    still = "1 0 0 {x} 0 1 0 0 0 0 1 0"
    (tmp_path / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    path = tmp_path / "poses.txt"
    path.write_bytes(("\ufeff" + still.format(x=0) + "\r\n\r\n" + still.format(x=2) + "\r\n").encode())
    poses = read_poses(path)
    assert poses_of(["000000", "000002"], poses, path)[:, 0, 3].tolist() == [0, 2]
    with pytest.raises(SourceError, match="line 2, the pose of scan 000001"):
        poses_of(["000001"], poses, path)


def wide_rows(n: int, fifth: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.normal(0, 20, (n, 3)), rng.integers(0, 255, n), fifth]).astype(np.float32)


@pytest.mark.parametrize("n", [16, 1000, 2000])  # all of them whole rows of four, too
@pytest.mark.parametrize("fifth", ["ring", "time"])
def test_rows_of_five_are_told_from_rows_of_four(tmp_path: Path, n: int, fifth: str) -> None:
    column = np.arange(n) % 32 if fifth == "ring" else np.linspace(0, 0.1, n)
    rows = wide_rows(n, column)
    folder = sequence(tmp_path, [0])
    rows.tofile(folder / "000000.bin")
    (ref,) = SOURCES["semantickitti"].scans(tmp_path, "00")
    with pytest.raises(SourceError, match=r"000000\.bin.*--columns 5"):
        SOURCES["semantickitti"].read(ref, with_labels=False)


def test_rows_of_four_stay_rows_of_four(real_data: Path) -> None:
    for file in sorted(real_data.glob("semantickitti/sequences/*/velodyne/00000[05].bin")):
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        assert not any(looks_wide(rows[: len(rows) // 5 * 5 - 5 * k]) for k in range(4))
    assert not looks_wide(np.zeros((100, 4), np.float32))
    assert not looks_wide((np.arange(400) % 50).reshape(-1, 4).astype(np.float32))  # all whole


def test_other_lengths_name_the_option(tmp_path: Path) -> None:
    folder = sequence(tmp_path, [0])
    wide_rows(17, np.arange(17)).tofile(folder / "000000.bin")
    (ref,) = SOURCES["semantickitti"].scans(tmp_path, "00")
    with pytest.raises(SourceError, match=r"not a multiple of 16; rows of 5\? then --columns 5"):
        SOURCES["semantickitti"].read(ref, with_labels=False)
