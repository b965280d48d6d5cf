"""MCAP files as logs: with and without index, chunks, compression; bombs and lies are refused."""

from io import BytesIO
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from salpcc.schemas.errors import SourceError
from salpcc.schemas.mcap_chunks import MAX_RECORD, compress, decompress
from salpcc.stages.ingest.sources.bag import find_log
from salpcc.stages.ingest.sources.mcap_log import McapLog


def write(path: Path, **options: object) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, **options)
        writer.start("ros2", "test")
        channels = [writer.register_channel(f"/{n}", "json", 0, {"n": str(n)}) for n in range(3)]
        for time in range(30):
            writer.add_message(channels[time % 3], time // 2, b"%d" % time, time, time)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.ZSTD},
        {"compression": CompressionType.LZ4},
        {"use_chunking": False},
        {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False},
        {"repeat_channels": False},
    ],
)
def test_every_message_is_read_and_found_again(options: dict[str, object], tmp_path: Path) -> None:
    log = McapLog([write(tmp_path / "a.mcap", **options)])
    assert [channel.topic for channel in log.channels.values()] == ["/0", "/1", "/2"]
    found = list(log.messages())
    assert [(m.log_time, m.publish_time, m.sequence, m.data) for m in found] == [
        (time // 2, time, time, b"%d" % time) for time in range(30)
    ]
    assert all(log.message("", m.log_time, m.at) == m for m in found)
    one = next(iter(log.channels))
    assert [m.data for m in log.messages({one})] == [m.data for m in found if m.channel == one]


def test_channels_of_several_files_are_one(tmp_path: Path) -> None:
    log = McapLog([write(tmp_path / "a.mcap"), write(tmp_path / "b.mcap", use_chunking=False)])
    assert len(log.channels) == 3 and len(list(log.messages())) == 60


def test_what_is_cut_off_or_flipped_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    whole = path.read_bytes()
    for damaged in (whole[:100], whole[:-200], b"x" + whole[1:], whole[:150] + b"\xff" + whole[151:], b""):
        path.write_bytes(damaged)
        with pytest.raises(SourceError, match=r"a\.mcap"):
            list(McapLog([path]).messages())


def test_bombs_are_refused() -> None:
    packed = compress(bytes(1 << 20))
    for size in (0, 100, (1 << 20) - 1, (1 << 20) + 1, MAX_RECORD + 1, 1 << 62):
        with pytest.raises(ValueError, match="chunk"):
            decompress("zstd", packed, size)
    assert decompress("zstd", packed, 1 << 20) == bytes(1 << 20)
    assert decompress("", BytesIO(b"abc").read(), 3) == b"abc"


def test_a_log_of_another_name_is_told_so(tmp_path: Path) -> None:
    """Such as one that is not of the archive, or was renamed: it is a log all the same."""
    path = write(tmp_path / "other.mcap")
    with pytest.raises(SourceError, match=r"other\.mcap: a log of another name than drive.* drive\.mcap$"):
        find_log(path, "drive")
    link = tmp_path / "drive.mcap"
    link.symlink_to(path)
    assert find_log(link, "drive") == link
