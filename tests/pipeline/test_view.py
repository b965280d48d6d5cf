"""Looking at scans: what is shown of an archive, a log and a map, in which colours, and where along the path."""

import os
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from salpcc.pipeline import encode_scans
from salpcc.pipeline.archive import Archive
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.view import Drive, Palette, scans_of, step, view
from salpcc.schemas.errors import UsageError
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources import SOURCES


@pytest.fixture(scope="module")
def archive(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = SOURCES["semantickitti"]
    scans = [source.read(ref, True) for ref in source.scans(toy_root, "01")]
    options: dict[str, Any] = {"labels": "given", "keep_movable": False, "effort": "fast", "gop": 2}
    return encode_scans(scans, tmp_path_factory.mktemp("view") / "01.mcap", "01", **options)


def moving(number: int, motion: tuple[float, ...] | None) -> Scan:
    points = np.zeros((2, 3), np.float32)
    return Scan(f"{number:06d}", points, points[:, 0], motion=None if motion is None else np.array(motion))


def test_archives_logs_and_maps(archive: Path, tmp_path: Path) -> None:
    assert [scan.name for scan in scans_of(archive, "all", None)] == ["000000", "000001", "000007"]
    assert [scan.name for scan in scans_of(archive, "all", (1, 8))] == ["000001", "000007"]
    static = next(scans_of(archive, "static", None))
    assert len(static) < len(next(scans_of(archive, "all", None)))
    with Archive.open(archive) as opened:
        list(EXPORTS["mcap"](opened, iter(opened), tmp_path))
    (log,) = tmp_path.rglob("*.mcap")
    clouds = list(scans_of(log.parent, "all", None))
    assert [len(scan) for scan in clouds] == [len(scan) for scan in scans_of(archive, "all", None)]
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "map.mcap").write_bytes(log.read_bytes())
    assert len(list(scans_of(tmp_path / "map", "all", (0, 1)))) == 1
    (tmp_path / "empty").mkdir()
    for wrong, said in ((tmp_path / "none", "not found"), (tmp_path / "empty", "no archive, log or")):
        with pytest.raises(UsageError, match=said):
            next(scans_of(wrong, "all", None))
    with pytest.raises(UsageError, match="no scan of it is of these frames; it holds"):
        next(scans_of(archive, "all", (50, 60)))


def test_colours_tell_what_is_known(archive: Path) -> None:
    palette = Palette()
    scans = list(scans_of(archive, "all", None))
    for scan in scans:
        colours = palette.of(scan)
        assert set(colours) == {"height", "intensity", "class", "layer"}
        assert all(c.shape == (len(scan), 3) and c.dtype == np.uint8 for c in colours.values())
        assert scan.classes is not None and scan.movable is not None
        assert (colours["class"] == np.array([CLASSES[c].colour for c in scan.classes])).all()
        assert len(np.unique(colours["layer"][scan.movable], axis=0)) == 1
        high, low = (colours["height"][at(scan.points[:, 2])] for at in (np.argmax, np.argmin))
        assert high.astype(int).sum() > low.astype(int).sum()
    limits = dict(palette.limits)
    palette.of(moving(9, None))
    assert palette.limits == limits  # the first scan settles them
    labels = np.array([10, 40 | 7 << 16], np.uint32)
    labelled = replace(moving(0, None), labels=labels)
    assert Palette().of(labelled)["class"].tolist() == [list(CLASSES[c].colour) for c in (1, 9)]
    assert "class" not in Palette().of(replace(labelled, labels=labels + 9999))
    off = palette.of(scans[0], np.linspace(0, 0.01, len(scans[0])))["error"].astype(int).sum(axis=1)
    assert off[0] < off[len(off) // 2] < off[-1] and palette.title("error") == "error 0 to 9.8 mm"
    assert palette.title("class") == "class"
    nothing = Palette().of(Scan("a", np.full((3, 3), np.nan, np.float32), np.zeros(3, np.float32)))
    assert set(nothing) == {"height", "intensity"} and nothing["height"].shape == (3, 3)


def test_steps_are_rotations() -> None:
    motion = np.array([-1.0, 0.1, 0.02, 0.01, -0.02, -0.3])
    pose = step(motion, 2)
    assert np.allclose(pose[:3, :3], Rotation.from_rotvec(-2 * motion[3:]).as_matrix(), atol=1e-12)
    assert np.allclose(pose[:3, 3], -2 * motion[:3])
    assert np.allclose(step(np.zeros(6), 1), np.eye(4))


def test_the_path_adds_motions_up() -> None:
    """A quarter turn to the left in 4 steps of 1 m, one of them over two turns; then a gap, over which nothing is known."""
    drive = Drive()
    left = (-1.0, 0, 0, 0, 0, -np.pi / 8)
    for number in (0, 1, 3, 4):
        pose = drive.at(moving(number, left))
    assert np.allclose(pose[:3, 0], [0, 1, 0], atol=1e-12) and pose[1, 3] > 0.5
    again = drive.at(moving(100, left))
    assert (again == pose).all()
    drive.at(moving(101, None))
    assert [len(path) for path in drive.paths] == [4, 2] and drive.scans == 6


def test_poses_come_before_motions() -> None:
    """They may be in any frame, far off; a scan without one goes on by its motion."""
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = Rotation.from_rotvec([0, 0, 1]).as_matrix(), (4e5, 5e6, 30)
    ahead = start @ step(np.array([-3.0, 0, 0, 0, 0, 0]), 1)
    drive = Drive({"000000": start, "000001": ahead})
    still = (0.0,) * 6
    assert np.allclose(drive.at(moving(0, still)), np.eye(4), atol=1e-9)
    assert np.allclose(drive.at(moving(1, still))[:3, 3], [3, 0, 0], atol=1e-8)
    assert np.allclose(drive.at(moving(2, (-1.0, 0, 0, 0, 0, 0)))[:3, 3], [4, 0, 0], atol=1e-8)


def test_a_recording_is_written(archive: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    assert view(archive, save=tmp_path / "a.rrd", frames=(0, 2)) == 2
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "a.rrd")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for entity in ("height", "intensity", "class", "layer"):
        assert re.search(rf"/sensor/{entity}\b", printed)
    assert "/path" in printed


def test_a_recording_that_finds_no_room_is_none(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rerun's writer ends without a word on a full disk; here its file is cut off instead, as it may wait for that writer for ever."""
    rr = pytest.importorskip("rerun")
    (tmp_path / "a.rrd").write_bytes(b"of before")
    closed = rr.disconnect

    def cut_off() -> None:
        closed()
        for part in tmp_path.iterdir():
            if part.name != "a.rrd":
                os.truncate(part, 1000)

    monkeypatch.setattr(rr, "disconnect", cut_off)
    with pytest.raises(OSError, match=r"a\.rrd"):
        view(archive, save=tmp_path / "a.rrd")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"of before"]


def test_view_on_the_command_line(archive: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")

    def command(*arguments: object) -> tuple[int, str]:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        return result.exit_code, result.output + str(result.exception or "")

    code, said = command("view", archive, "--frames", "7:", "--save", tmp_path / "a.rrd")
    assert code == 0 and said.startswith("1 scan: ") and (tmp_path / "a.rrd").stat().st_size > 0
    code, said = command("view", archive, "--web", "--save", tmp_path / "a.rrd")
    assert code == 1 and "choose one" in said
    before = archive.read_bytes()
    code, said = command("view", archive, "--save", archive)
    assert code == 1 and "a recording is a file NAME.rrd" in said and archive.read_bytes() == before
    assert command("view", archive, "--frames", "0:1", "--save", tmp_path / "new" / "a.rrd")[0] == 0
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(IsADirectoryError):
        view(archive, save=tmp_path / "folder.rrd")
    code, said = command("view", archive, "--against", tmp_path, "--save", tmp_path / "b.rrd")
    assert code == 1 and "made from arrays, there are no files to compare with" in said
    code, said = command("view", tmp_path, "--against", tmp_path, "--save", tmp_path / "b.rrd")
    assert code == 1 and "only an archive has a source" in said
    code, said = command("view", tmp_path / "none", "--against", tmp_path, "--save", tmp_path / "b.rrd")
    assert code == 1 and "not found" in said
    code, said = command("view", archive, "--layers", "moving", "--save", tmp_path / "b.rrd")
    assert code == 1 and "choose from" in said


def test_a_browser_shows_the_scans(archive: Path, tmp_path: Path, browser: Any) -> None:
    """``view --web`` says where it shows them, and the viewer there draws points in the colours of heights."""
    pytest.importorskip("rerun")
    command = [sys.executable, "-m", "salpcc.pipeline.cli", "view", str(archive), "--web"]
    opens_none = {**os.environ, "BROWSER": "true"}
    alone = {"env": opens_none, "start_new_session": True}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **alone) as shown:
        assert shown.stderr is not None
        try:
            said = next(line for line in shown.stderr if "http://" in line)
            (address,) = re.findall(r"http://127\S+", said)
            while True:
                with suppress(OSError), urlopen(address.split("?")[0]):
                    break
                assert shown.poll() is None
            browser.goto(address, wait_until="commit")
            for _ in range(200):  # the viewer starts, then scans arrive
                picture = imread(BytesIO(browser.screenshot(path=tmp_path / "view.png")))[60:-60, :, :3]
                vivid = picture[np.ptp(picture, axis=2) > 0.25]
                most = np.bincount(vivid.argmax(axis=1), minlength=3)
                if (most > 200).all():  # blue heights, green ones and yellow ones: the viewer itself is blue
                    break
                browser.wait_for_timeout(250)
            assert (most > 200).all()
        finally:
            shown.terminate()  # the viewer's server ends, too
    with pytest.raises(OSError), urlopen(address.split("?")[0]):
        pass
