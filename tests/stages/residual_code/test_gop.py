"""GOPs: exact round trips, honest byte counts, and no way for damage to pass."""

import zlib
from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.sensor.header import content_crc
from salpcc.stages.segment.task import quantise

EFFORTS = ("fast", "default", "max")


@pytest.fixture(scope="module")
def sweeps(make_scan, sensor):
    scans = [make_scan(seed, stride=8) for seed in range(2)]
    scans.append(make_scan(2, stride=8, motion=None))
    scans[1].points[[3, 30, 300]] = np.nan
    scans.append(
        replace(scans[0], intensity=np.random.default_rng(0).random(len(scans[0])).astype(np.float32))
    )
    return [scan_to_sweep(scan, sensor) for scan in scans]


@pytest.fixture(scope="module")
def payloads(sweeps, sensor):
    return [payload.data for payload in encode_gop(sweeps, sensor, "fast")]


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("max_error", [None, 0.002, 0.02])
def test_round_trip(sweeps, sensor, effort, max_error) -> None:
    task = sweeps if max_error is None else [quantise(sweep, sensor, max_error) for sweep in sweeps]
    payloads = encode_gop(task, sensor, effort)
    for sweep, back, payload in zip(
        task, decode_gop((p.data for p in payloads), sensor), payloads, strict=True
    ):
        assert content_crc(back) == content_crc(sweep)
        assert sum(payload.sizes.values()) == len(payload.data)
        a, b = sweep_to_scan(sweep, sensor), sweep_to_scan(back, sensor)
        assert a.points.tobytes() == b.points.tobytes()
        assert (a.classes == b.classes).all()


@pytest.mark.parametrize("n", [0, 1, 10, 2000])
@pytest.mark.parametrize("max_error", [None, 0.01])
def test_scans_without_a_lattice(sensor, n, max_error) -> None:
    rng = np.random.default_rng(n)
    points = rng.normal(0, 20, (n, 3)).astype(np.float32)
    points[:1] = np.nan
    sweep = scan_to_sweep(Scan("x", points, rng.random(n).astype(np.float32)), sensor)
    task = sweep if max_error is None else quantise(sweep, sensor, max_error)
    (back,) = decode_gop([encode_gop([task], sensor, "fast")[0].data], sensor)
    assert content_crc(back) == content_crc(task)


def test_quantised_scans_are_smaller(sweeps, sensor) -> None:
    sizes = [
        sum(
            p.sizes["geometry"]
            for p in encode_gop([quantise(s, sensor, e) for s in sweeps[:3]], sensor, "fast")
        )
        for e in (0.001, 0.005, 0.02)
    ]
    exact = sum(p.sizes["geometry"] for p in encode_gop(sweeps[:3], sensor, "fast"))
    assert exact > sizes[0] > 1.2 * sizes[1] > 1.4 * sizes[2]


def _refused(data: bytes, sensor) -> bool:
    try:
        list(decode_gop([data], sensor))
    except ArchiveError:
        return True
    return False


def test_every_flipped_bit_and_every_cut_is_refused(payloads, sensor) -> None:
    data = payloads[0]
    rng = np.random.default_rng(0)
    for bit in rng.integers(0, 8 * len(data), 300):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << (bit % 8)
        assert _refused(bytes(damaged), sensor)
    for size in [0, 1, 30, len(data) - 1, *rng.integers(0, len(data), 20)]:
        assert _refused(data[:size], sensor)


def test_damage_under_a_valid_outer_checksum_is_refused(payloads, sensor) -> None:
    """A hostile payload carries a right checksum: the kernels must survive it and the content CRC tell."""
    rng = np.random.default_rng(1)
    body = payloads[0][:-4]
    for _ in range(200):
        damaged = bytearray(body)
        for _ in range(rng.integers(1, 6)):
            damaged[rng.integers(0, len(damaged))] = rng.integers(0, 256)
        if bytes(damaged) == body:
            continue
        assert _refused(bytes(damaged) + zlib.crc32(damaged).to_bytes(4, "little"), sensor)


def test_a_scan_of_the_wrong_place_in_its_gop_is_refused(payloads, sensor) -> None:
    assert _refused(payloads[1], sensor)


@pytest.mark.parametrize("other", [-1, 1])
def test_another_codec_version_is_named(payloads, sensor, other) -> None:
    body = bytes([payloads[0][0] + other]) + payloads[0][1:-4]
    with pytest.raises(ArchiveError, match="codec version"):
        list(decode_gop([body + zlib.crc32(body).to_bytes(4, "little")], sensor))


def test_a_payload_of_networks_that_do_not_know_the_sensor_is_refused(sweeps, sensor) -> None:
    data = encode_gop(sweeps[:1], sensor, "default")[0].data
    more = {k: np.tile(getattr(sensor, k), 2) for k in ("theta", "z0", "h", "phi0", "d0", "shift")}
    assert _refused(data, replace(sensor, **more))


def test_a_sensor_that_no_network_knows_is_coded_fast(sensor) -> None:
    few = {k: getattr(sensor, k)[::4] for k in ("theta", "z0", "h", "phi0", "d0", "shift")}
    small = replace(sensor, **few)
    laser = np.repeat(np.arange(16), 500)
    tick = np.tile(np.arange(0, 4000, 8), 16).astype(np.int32)
    count = np.full(len(tick), 5000, np.int32)
    none = np.full(len(tick), 13, np.uint8)
    nothing = np.zeros((0, 4), np.float32)
    sweep = Sweep(
        "x", 0, "velodyne", len(tick), None, 1, 0.0, laser.astype(np.uint8), tick, count,
        np.zeros(len(tick), np.float32), none, none, None, np.zeros(0, np.int64), nothing, None,
    )  # fmt: skip
    (back,) = decode_gop([encode_gop([sweep], small, "max")[0].data], small)
    assert content_crc(back) == content_crc(sweep)


def test_headers_that_no_writer_writes_are_refused(payloads, sensor) -> None:
    body = bytearray(payloads[0][:-4])
    for place, value in ((1, 255), (3, 1), (16, 7)):  # flags, reserved, step of an exact scan
        changed = bytearray(body)
        changed[place] = value
        assert _refused(bytes(changed) + zlib.crc32(changed).to_bytes(4, "little"), sensor)
