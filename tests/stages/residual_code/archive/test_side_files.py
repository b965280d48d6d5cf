"""Side files: whole and small, under names that cannot lead elsewhere, and found in what is left of an archive."""

import lzma
from pathlib import Path

import pytest
from mcap.records import Attachment

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.files import mapped
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import (
    MOST_BYTES,
    SideFile,
    side_file,
    side_name,
    side_record,
)
from salpcc.stages.residual_code.archive.side_salvage import side_files
from salpcc.stages.residual_code.archive.writer import write_archive

FACTS = ArchiveFacts("04", "semantickitti", "d1", {}, load_sensor("hdl64e"))
FILES = [
    SideFile("times.txt", b"0.0\r\n0.1"),
    SideFile("oxts/data/ä 1.txt", b""),
    SideFile("a/b", bytes(range(256))),
]


def archive(path: Path, files: list[SideFile] = FILES) -> Path:
    entry = ScanEntry("000000", 1, 1, 0, 0, 1, 0, 0, 0)
    write_archive(path, FACTS, [[ScanPayload(entry, 0, "v", b"x")]], side=files)
    return path


def test_files_come_back(tmp_path: Path) -> None:
    reader = ArchiveReader(archive(tmp_path / "a.mcap"))
    assert [reader.side_file(name) for name in reader.side] == FILES
    assert reader.facts.version == "3.0" and not reader.log and not list(reader.enclosed())
    reader.check()
    bare = ArchiveReader(archive(tmp_path / "b.mcap", []))
    assert not bare.side and reader.size - bare.size > sum(reader.side.values())
    with pytest.raises(KeyError):
        bare.side_file("times.txt")


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "/etc/passwd", "../up", "a/../../up", "a//b", "a/", "a\\b", "C:/x", "a/./b", "x\0y", "a\nb",
     "velodyne/000000.bin", "a" * 1001, " a", "a /b"],
)  # fmt: skip
def test_no_name_leads_elsewhere(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot name"):
        side_name(name)
    with pytest.raises(ArchiveError):
        ArchiveReader(archive(tmp_path / "a.mcap", [SideFile(name, b"x")]))


def test_what_grows_too_large_is_refused() -> None:
    bomb = lzma.compress(bytes(MOST_BYTES + 1))
    with pytest.raises(ValueError, match="more than"):
        side_file(Attachment(0, 0, "side:x", "", bomb))
    largest = SideFile("x", bytes(MOST_BYTES))
    assert side_file(side_record(largest)) == largest
    for bad in (
        bomb[:-9],
        side_record(FILES[0]).data[:-4],
        side_record(FILES[0]).data + b"more",
        b"",
        b"text",
    ):
        with pytest.raises(ValueError):
            side_file(Attachment(0, 0, "side:x", "", bad))


def test_whole_ones_are_found_without_an_index(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    at = data.find(b"side:oxts") + 40
    data[at] ^= 1
    path.write_bytes(data[: data.find(b"side:times") + 400] + data[data.find(b"side:times") + 400 : -200])
    assert side_files(mapped(path)) == ([FILES[0], FILES[2]], 1)
