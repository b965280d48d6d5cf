"""Messages: our CDR is what ROS 2's own tools read, and back."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.messages import COMPRESSED, PLAIN, SCHEMA_TEXT, CloudMessage

clouds = st.builds(
    CloudMessage,
    stamp=st.integers(0, 2**31 * 10**9 - 1),
    frame_id=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9),
    width=st.integers(0, 2**28 - 1),
    data=st.binary(max_size=50),
    format=st.none() | st.just("salpcc/1.0"),
    is_dense=st.booleans(),
)


@given(clouds)
def test_message_comes_back(cloud: CloudMessage) -> None:
    assert CloudMessage.from_cdr(cloud.to_cdr(), compressed=cloud.format is not None) == cloud


@given(clouds)
def test_ros_reads_the_same(cloud: CloudMessage) -> None:
    name, data = (COMPRESSED, "compressed_data") if cloud.format is not None else (PLAIN, "data")
    read = generate_dynamic(name, SCHEMA_TEXT[name])[name](cloud.to_cdr())
    assert read.header.stamp.sec * 10**9 + read.header.stamp.nanosec == cloud.stamp
    assert (read.header.frame_id, read.width, read.height) == (cloud.frame_id, cloud.width, 1)
    assert bytes(getattr(read, data)) == cloud.data
    assert [(f.name, f.offset, f.datatype, f.count) for f in read.fields] == list(cloud.fields)
    assert (read.is_dense, read.row_step) == (cloud.is_dense, 16 * cloud.width)
    assert cloud.format is None or read.format == cloud.format


def test_every_truncation_is_refused() -> None:
    data = CloudMessage(5, "velodyne", 3, b"payload", format="salpcc/1.0").to_cdr()
    for length in range(len(data)):
        with pytest.raises(ArchiveError):
            CloudMessage.from_cdr(data[:length], compressed=True)


@given(st.binary(max_size=200))
def test_garbage_is_refused_or_read_but_never_crashes(data: bytes) -> None:
    with contextlib.suppress(ArchiveError):
        CloudMessage.from_cdr(b"\x00\x01\x00\x00" + data, compressed=True)
