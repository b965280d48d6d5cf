"""Recorded messages of any layout: every byte comes back, or every point within the bound."""

import struct
import zlib
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from salpcc.schemas.cloud_layout import LayoutError
from salpcc.schemas.config import Effort
from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import sweeps_to_table, table_to_sweeps
from salpcc.stages.ingest.point_cloud import message_to_scan, scan_columns, scan_to_message
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.segment.task import keep, quantise

SENSOR = load_sensor("hdl64e")
STORES = {"cdr": get_typestore(Stores.ROS2_HUMBLE), "ros1": get_typestore(Stores.ROS1_NOETIC)}
KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
TYPE = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class Shape:
    """A layout of points, and how its message is serialised."""

    encoding: str
    little: bool
    height: int
    width: int
    big_endian: bool
    fields: tuple[tuple[str, int, int, int], ...]
    point_step: int
    row_padding: int
    frame_id: str


@st.composite
def shapes(draw: st.DrawFn) -> Shape:
    names = ["x", "y", "z", *draw(st.permutations(["intensity", "ring", "t", "", "normal"]))]
    names = names[: draw(st.integers(3, 8))]
    fields, end = [], 0
    for name in names:
        end += draw(st.integers(0, 3))
        if name in ("x", "y", "z"):
            kind, count = draw(st.sampled_from([7, 7, 8])), 1
        else:
            kind, count = draw(st.integers(1, 8)), draw(st.sampled_from([1, 1, 1, 0, 3]))
        fields.append((name, end, kind, count))
        end += count * np.dtype(KINDS[kind - 1]).itemsize
    if draw(st.booleans()):
        fields.append(("alias", fields[0][1], 6, 1))  # the bytes of x by another name, as rgb and rgba have
    height = draw(st.integers(1, 3))
    return Shape(
        draw(st.sampled_from(["cdr", "ros1"])),
        draw(st.booleans()),
        height,
        draw(st.integers(0, 30)),
        draw(st.booleans()),
        tuple(fields),
        end + draw(st.integers(0, 5)),
        draw(st.integers(0, 4)),
        draw(st.sampled_from(["", "velodyne", "тест"])),
    )


def message(shape: Shape, seed: int, number: int = 0) -> bytes:
    """Serialise a cloud of that shape: streets of smooth numbers, noise, NaN, and garbage as padding."""
    rng = np.random.default_rng(seed)
    n = shape.height * shape.width
    rows = rng.integers(0, 256, (n, shape.point_step), dtype=np.uint8)
    for name, offset, datatype, count in shape.fields:
        kind = np.dtype(KINDS[datatype - 1]).newbyteorder(">" if shape.big_endian else "<")
        for element in range(count):
            values = rng.normal(0, 20, n) if name in ("x", "y", "z") else np.arange(n) % 7
            at = offset + element * kind.itemsize
            if rng.random() < 0.7 and name != "alias":
                rows[:, at : at + kind.itemsize] = (
                    values.astype(kind).view(np.uint8).reshape(n, kind.itemsize)
                )
    step = shape.width * shape.point_step + shape.row_padding
    data = rng.integers(0, 256, (shape.height, step), dtype=np.uint8)
    if n:
        data[:, : shape.width * shape.point_step] = rows.reshape(shape.height, -1)
    types = STORES[shape.encoding].types
    stamp = types["builtin_interfaces/msg/Time"](sec=1_600_000_000, nanosec=number)
    extra = {"seq": number} if shape.encoding == "ros1" else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=shape.frame_id, **extra)
    make = types["sensor_msgs/msg/PointField"]
    cloud = types[TYPE](
        header=header,
        height=shape.height,
        width=shape.width,
        fields=[make(name=f, offset=o, datatype=d, count=c) for f, o, d, c in shape.fields],
        is_bigendian=shape.big_endian,
        point_step=shape.point_step,
        row_step=step,
        data=data.ravel(),
        is_dense=False,
    )
    if shape.encoding == "ros1":
        return bytes(STORES["ros1"].serialize_ros1(cloud, TYPE))
    return bytes(STORES["cdr"].serialize_cdr(cloud, TYPE, little_endian=shape.little))


def scan_of(raw: bytes, encoding: str, number: int = 0) -> Scan:
    recorded = LogMessage(1, 100 + number, 105 + number, number, raw)
    return message_to_scan(recorded, encoding, "/points", f"{number:06d}")


pytestmark = pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
FAST = settings(max_examples=60, suppress_health_check=list(HealthCheck))


@FAST
@given(shapes(), st.integers(0, 99))
def test_every_byte_of_every_layout_comes_back(shape: Shape, seed: int) -> None:
    raws = [message(shape, seed + number, number) for number in range(2)]
    scans = [scan_of(raw, shape.encoding, number) for number, raw in enumerate(raws)]
    assert [scan_to_message(scan) for scan in scans] == raws
    if seed % 2:
        scans = [replace(scan, classes=(np.arange(len(scan)) // 5 % 20).astype(np.uint8)) for scan in scans]
    sweeps = table_to_sweeps(sweeps_to_table([scan_to_sweep(scan, SENSOR) for scan in scans]))
    payloads = encode_gop(sweeps, SENSOR, "fast")
    assert all(sum(payload.sizes.values()) == len(payload.data) for payload in payloads)
    back = [sweep_to_scan(sweep, SENSOR) for sweep in decode_gop([p.data for p in payloads], SENSOR)]
    assert [scan_to_message(scan) for scan in back] == raws
    for scan, decoded in zip(scans, back, strict=True):
        assert decoded.intensity.tobytes() == scan.intensity.tobytes()
        assert (decoded.classes is None) == (scan.classes is None)
        if scan.classes is not None and decoded.classes is not None:
            assert decoded.classes.tobytes() == scan.classes.tobytes()
        assert decoded.cloud is not None and scan.cloud is not None
        assert (decoded.cloud.delay, decoded.cloud.sequence) == (scan.cloud.delay, scan.cloud.sequence)


@FAST
@given(shapes(), st.integers(0, 99))
def test_every_field_is_a_column_of_its_type(shape: Shape, seed: int) -> None:
    """Read by rosbags and NumPy: the first field of a name has it, no two columns share one, none is invented."""
    raw = message(shape, seed)
    read = STORES[shape.encoding]
    cloud = (read.deserialize_ros1 if shape.encoding == "ros1" else read.deserialize_cdr)(raw, TYPE)
    rows = cloud.data.reshape(shape.height, -1)[:, : shape.width * shape.point_step].reshape(
        -1, shape.point_step
    )
    columns = scan_columns(scan_of(raw, shape.encoding))
    elements = 0
    for name, offset, datatype, count in shape.fields:
        kind = np.dtype(KINDS[datatype - 1]).newbyteorder(">" if shape.big_endian else "<")
        fits = offset + kind.itemsize <= shape.point_step  # a count of 0 may stand at the end
        elements += count if count else int(fits)
        if fits:
            column = columns[name or "unnamed"]
            assert column.dtype == kind.newbyteorder("=")
            bytes_ = np.ascontiguousarray(rows[:, offset : offset + kind.itemsize])
            assert column.astype(kind).tobytes() == bytes_.tobytes()
    assert len(columns) == elements


@FAST
@given(shapes(), st.integers(0, 99), st.sampled_from([0.001, 0.02]))
def test_points_are_within_the_bound_and_other_fields_exact(shape: Shape, seed: int, bound: float) -> None:
    scan = scan_of(message(shape, seed), shape.encoding)
    sweep = quantise(scan_to_sweep(scan, SENSOR), SENSOR, bound)
    (decoded,) = decode_gop([payload.data for payload in encode_gop([sweep], SENSOR, "fast")], SENSOR)
    source, back = scan_columns(scan), scan_columns(sweep_to_scan(decoded, SENSOR))
    xyz = [np.column_stack([columns[axis].astype("f8") for axis in "xyz"]) for columns in (source, back)]
    same = (xyz[0] == xyz[1]) | (np.isnan(xyz[0]) & np.isnan(xyz[1]))
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.sqrt(np.square(np.where(same, 0.0, xyz[0] - xyz[1])).sum(axis=1))
    assert (error <= bound).all()
    aliased = shape.fields[-1][0] == "alias"  # then the bytes of x are another field's, too
    for name in source.keys() - set("xyz"):
        assert aliased or back[name].tobytes() == source[name].tobytes()


@FAST
@given(shapes(), st.integers(0, 99))
def test_what_is_dropped_leaves_one_row_of_the_rest(shape: Shape, seed: int) -> None:
    scan = scan_of(message(shape, seed), shape.encoding)
    sweep = scan_to_sweep(scan, SENSOR)
    kept = np.random.default_rng(seed).random(len(sweep.stray_index)) < 0.5
    task = keep(sweep, SENSOR, np.ones(len(sweep.laser), np.bool_), kept)
    (decoded,) = decode_gop([payload.data for payload in encode_gop([task], SENSOR, "fast")], SENSOR)
    raw = scan_to_message(sweep_to_scan(decoded, SENSOR))
    again = scan_of(raw, shape.encoding)
    if not kept.all():
        assert again.cloud is not None
        assert (again.cloud.layout.height, again.cloud.layout.width) == (1, len(task))
    rest, columns = scan_columns(again), scan_columns(scan)
    if len(sweep.laser) == 0:
        assert all(rest[name].tobytes() == columns[name][kept].tobytes() for name in columns)


@FAST
@given(shapes(), st.integers(0, 99), st.data())
def test_damaged_messages_are_refused_or_come_back_as_they_are(
    shape: Shape, seed: int, data: st.DataObject
) -> None:
    raw = bytearray(message(shape, seed))
    head = len(raw) - shape.height * (shape.width * shape.point_step + shape.row_padding)
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, max(head, 8) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(raw)))
    for damaged in (bytes(raw), bytes(raw[:cut])):
        try:
            scan = scan_of(damaged, shape.encoding)
        except LayoutError:
            continue
        assert scan_to_message(scan) == damaged


@pytest.mark.parametrize("effort", ["fast", "default"])
def test_light_without_a_return_is_none_of_the_intensities(effort: Effort) -> None:
    rng = np.random.default_rng(3)
    points = np.zeros((16, 128, 4), np.float32)
    seen = rng.random((16, 128)) < 0.5
    points[..., :3] = rng.uniform(1, 9, (16, 128, 3)) * seen[..., None]
    points[..., 3] = np.where(seen, 50, rng.integers(0, 256, (16, 128)))
    for axis in (points, points[:1]):  # also of few points
        height, width = axis.shape[:2]
        cloud = CloudMessage(7, "lidar", width, axis.tobytes(), None, False, height)
        sweep = scan_to_sweep(scan_of(cloud.to_cdr(), "cdr"), SENSOR)
        (payload,) = encode_gop([sweep], SENSOR, effort)
        (decoded,) = decode_gop([payload.data], SENSOR)
        assert scan_to_message(sweep_to_scan(decoded, SENSOR)) == cloud.to_cdr()
        noise = (~seen[: len(axis)]).sum()
        assert payload.sizes["intensity"] < 60 and payload.sizes["side"] > 0.9 * noise


def test_sizes_are_checked_before_anything_is_allocated() -> None:
    shape = Shape("cdr", True, 1, 4, False, (("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1)), 12, 0, "v")
    raw = message(shape, 0)
    layout = scan_of(raw, "cdr").cloud.layout  # type: ignore[union-attr]
    height, width, _, length = layout.numbers  # some drivers write a row_step that is none
    for place in (height, width, length):
        bomb = bytearray(raw)
        struct.pack_into("<I", bomb, place, 0xFFFFFFF0)
        with pytest.raises(LayoutError):
            scan_of(bytes(bomb), "cdr")


@settings(max_examples=150, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_damaged_payloads_are_refused_or_come_back_as_they_are(data: st.DataObject) -> None:
    """The last CRC is made right again, so that what lies below it has to notice."""
    fields = (("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 8, 1), ("intensity", 16, 2, 1), ("ring", 18, 4, 1))
    shape = Shape("cdr", True, 2, 12, False, fields, 22, 1, "v")
    source = message(shape, 3)
    (payload,) = encode_gop([scan_to_sweep(scan_of(source, "cdr"), SENSOR)], SENSOR, "fast")
    raw = bytearray(payload.data[:-4])
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    damaged = bytes(raw) + struct.pack("<I", zlib.crc32(raw))
    try:
        (decoded,) = decode_gop([damaged], SENSOR)
    except ArchiveError:
        return
    assert scan_to_message(sweep_to_scan(decoded, SENSOR)) == source  # the last bit of a reach of -1, say
