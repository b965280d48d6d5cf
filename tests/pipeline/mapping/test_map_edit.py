"""What was removed of a map goes back into it, in all its files, by object and by box."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray
from plyfile import PlyData

from salpcc.pipeline.mapping import map_edit
from salpcc.pipeline.mapping.make_map import make_map
from salpcc.pipeline.mapping.map_edit import Restored, restore
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.schemas.errors import ShardError, UsageError
from salpcc.stages.mapping.tiles import Box


@pytest.fixture
def copy(explained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(explained, tmp_path / "map"))


def laz(out: Path, folder: str) -> NDArray[Any]:
    """Places in millimetres, class and count of all points in the LAZ files of a folder, ordered."""
    rows = []
    for path in (out / folder).glob("*.laz"):
        las = laspy.read(path)
        rows.append(np.column_stack([np.rint(1000 * np.array(las.xyz)), las.user_data, las.count]))
    found = np.concatenate(rows).astype(np.int64)
    return found[np.lexsort(found.T)]


def objects(out: Path) -> dict[int, dict[str, Any]]:
    return {row["object"]: row for row in json.loads((out / "removed" / "objects.json").read_text())}


def test_an_object_goes_back_into_all_files(copy: Path) -> None:
    before, removed, listed = laz(copy, "tiles"), laz(copy, "removed"), objects(copy)
    made = json.loads((copy / "map.json").read_text())
    assert sorted(listed) == list(range(1, len(listed) + 1))  # numbered by size
    assert listed[1]["voxels"] == max(row["voxels"] for row in listed.values())
    assert sum(row["voxels"] for row in listed.values()) == len(removed)
    pictured = (copy / "pictures" / "removed.png").read_bytes()
    summary = restore(copy, Restored(objects=(1,)), "by hand")
    after, left = laz(copy, "tiles"), laz(copy, "removed")
    assert len(after) - len(before) == len(removed) - len(left) == listed[1]["voxels"]
    both = np.concatenate([after, left])
    np.testing.assert_array_equal(
        both[np.lexsort(both.T)],
        (whole := np.concatenate([before, removed]))[np.lexsort(whole.T)],
    )
    assert {k: v for k, v in listed.items() if k != 1} == objects(copy)  # the others keep their numbers
    assert (copy / "pictures" / "removed.png").read_bytes() != pictured
    assert summary == json.loads((copy / "map.json").read_text())
    assert summary["voxels"]["kept"] == len(after) and summary["edits"][0]["voxels"] == listed[1]["voxels"]
    assert summary["edits"][0]["command"] == "by hand" and summary["edits"][0]["restored"]["objects"] == [1]
    assert summary["quality"] == [] and summary["inputs"] == made["inputs"]
    for tile in summary["tiles"]:
        vertices = len(PlyData.read(copy / "tiles" / f"{tile}.ply")["vertex"])
        assert vertices == len(laspy.read(copy / "tiles" / f"{tile}.laz"))
        assert f"POINTS {vertices}\n".encode() in (copy / "tiles" / f"{tile}.pcd").read_bytes()
    with open(copy / "map.mcap", "rb") as stream:
        messages = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert sum(message.decoded_message.width for message in messages) == len(after)


def test_a_box_puts_back_what_lies_in_it_and_nothing_else(copy: Path, explained: Path) -> None:
    removed, kept = laz(copy, "removed"), laz(copy, "tiles")
    middle = np.median(removed[:, :3], axis=0) / 1000
    low, high = middle - 5.0, middle + 5.0
    inside = ((removed[:, :3] >= 1000 * low) & (removed[:, :3] < 1000 * high)).all(axis=1)
    restore(copy, Restored(boxes=(Box.of([*low, *high]),)))
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal(laz(copy, "removed"), removed[~inside])
    assert len(laz(copy, "tiles")) == len(kept) + inside.sum()
    untouched = [
        path for path in (copy / "tiles").glob("*.ply")
        if path.read_bytes() == (explained / "tiles" / path.name).read_bytes()
    ]  # fmt: skip
    assert untouched  # tiles that the box does not touch
    summary = json.loads((copy / "map.json").read_text())
    assert len(list((copy / "shards").rglob("*.arrow"))) == len(summary["explained"])  # no older ones


def test_everything_put_back_is_the_map_that_was_not_cleaned(
    copy: Path, request_: Callable[..., MapRequest], made: Path, tmp_path: Path
) -> None:
    restore(copy, Restored(boxes=(Box.of([-500, -500, -500, 500, 500, 500]),)))
    everything = json.loads((copy / "map.json").read_text())["voxels"]
    assert everything["carved"] == everything["dropped"] == 0
    assert objects(copy) == {} and not list((copy / "removed").glob("*.laz"))
    with pytest.raises(UsageError, match="--restore object 1: nothing of that is removed"):
        restore(copy, Restored(objects=(1,)))


def test_an_interrupted_edit_ends_the_same(
    copy: Path, explained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(map_edit, "write_whole", lambda *_: (_ for _ in ()).throw(OSError("disk")))
        with pytest.raises(OSError, match="disk"):
            restore(copy, Restored(objects=(1, 2)))
    assert json.loads((copy / "map.json").read_text())["edits"] == []
    restore(copy, Restored(objects=(1, 2)))
    straight = Path(shutil.copytree(explained, tmp_path / "straight"))
    restore(straight, Restored(objects=(1, 2)))
    files = {path.relative_to(copy) for path in copy.rglob("*") if path.suffix in (".ply", ".arrow", ".png")}
    assert files == {
        p.relative_to(straight) for p in straight.rglob("*") if p.suffix in (".ply", ".arrow", ".png")
    }
    for name in files:
        if name.suffix != ".arrow":  # which state when they were made
            assert (copy / name).read_bytes() == (straight / name).read_bytes(), name


def test_what_cannot_be_edited_is_told(copy: Path, made: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not the folder of a map"):
        restore(tmp_path, Restored(objects=(1,)))
    plain = Path(shutil.copytree(made, tmp_path / "plain"))
    with pytest.raises(UsageError, match="make the map again with --explain"):
        restore(plain, Restored(objects=(1,)))
    before = laz(copy, "tiles")
    for restored in (
        Restored(objects=(1, 99999)), Restored(objects=(1,), boxes=(Box.of([900, 0, 0, 901, 1, 1]),)),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=r"nothing of that is removed; .*objects.json lists"):
            restore(copy, restored)
    np.testing.assert_array_equal(laz(copy, "tiles"), before)
    next((copy / "shards").rglob("*.arrow")).write_bytes(b"torn")
    with pytest.raises(ShardError, match="make the map again"):
        restore(copy, Restored(objects=(1,)))


def test_a_map_that_is_made_anew_tells_of_edits(
    copy: Path, request_: Callable[..., MapRequest], capsys: pytest.CaptureFixture[str]
) -> None:
    """The same command leaves an edited map; another one says what it does not hold."""
    same = request_(copy, formats=["laz", "ply", "pcd", "mcap"], explain=True)
    edited = restore(copy, Restored(objects=(1,)), "map edit map --restore 1")
    assert make_map(same) == edited
    other = make_map(request_(copy, formats=["ply"], explain=False, quiet=False))
    assert other["edits"] == [] and other["explained"] == []
    assert "had been edited, this one is not: map edit map --restore 1" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not list((copy / "shards").rglob("explained/*"))
