"""GOPs of the paper profile: what is decoded is what was coded, for every coder and every odd scan."""

import zlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import COLUMNS, ROWS, GridSweep
from salpcc.schemas.scan import Scan
from salpcc.stages.ground_fit.grid_planes import fit_ground
from salpcc.stages.ingest.paper_grid import row_elevations, scan_to_grid
from salpcc.stages.predict.paper.frames import predict_gop
from salpcc.stages.residual_code.paper import grid_payload
from salpcc.stages.residual_code.paper.grid_coder import decode_grids, encode_grid
from salpcc.stages.residual_code.paper.grid_header import content_crc
from salpcc.stages.residual_code.paper.grid_images import IMAGE_CODERS, ByteImages
from salpcc.stages.residual_code.paper.grid_payload import unpack
from salpcc.stages.residual_code.paper.grid_streams import GridState
from salpcc.stages.residual_code.paper.lossless import Lossless

CAR, ROAD = 1, 9


def encode(sweeps: list[GridSweep], coder: str) -> list[bytes]:
    models = GridState(coder)
    return [
        encode_grid(sweep, fit_ground(sweep), predicted, models).data
        for sweep, predicted in zip(sweeps, predict_gop(sweeps), strict=True)
    ]


def check(sweeps: list[GridSweep], coder: str) -> list[bytes]:
    payloads = encode(sweeps, coder)
    for sweep, back in zip(sweeps, decode_grids(payloads), strict=True):
        assert (back.level == sweep.level).all()
        assert back.intensity.tobytes() == sweep.intensity.tobytes()
        assert (back.classes is None) == (sweep.classes is None)
        assert content_crc(back) == content_crc(sweep)
    return payloads


def to_grids(scans: list[Scan], accuracy: float = 0.001) -> list[GridSweep]:
    elevation = row_elevations([scan.points for scan in scans])
    return [scan_to_grid(scan, accuracy, elevation) for scan in scans]


@pytest.fixture(scope="module")
def scans(make_scan) -> list[Scan]:
    return [make_scan(seed, stride=8, motion=None) for seed in range(3)]


@pytest.mark.parametrize("coder", IMAGE_CODERS)
def test_round_trip(scans, coder) -> None:
    check(to_grids(scans[:2], 0.005), coder)


def test_a_coder_is_a_row_of_the_table(scans, monkeypatch) -> None:
    toy = Lossless("Back to front", "", lambda plain: plain[::-1], lambda data, size: data[::-1])
    monkeypatch.setitem(IMAGE_CODERS, "toy", partial(ByteImages, toy))
    monkeypatch.setattr(grid_payload, "CODERS", (*grid_payload.CODERS, "toy"))
    check(to_grids(scans[:2], 0.005), "toy")


@pytest.mark.parametrize("accuracy", [0.001, 0.01, 0.05])
def test_accuracies(scans, accuracy) -> None:
    sizes = [len(data) for data in check(to_grids(scans[:2], accuracy), "context")]
    assert max(sizes) < 60_000


@pytest.mark.parametrize("coder", ["ppmd", "context"])
def test_odd_scans_in_one_gop(scans, coder) -> None:
    first = scans[0]
    few = np.full(len(first), CAR, np.uint8)
    few[:2] = ROAD
    nothing = np.zeros(len(first), np.bool_)
    half = first.points[:, 0] > 0
    odd = [
        first,
        replace(first, classes=few),  # fewer than three ground points
        replace(
            first, points=first.points[nothing], intensity=first.intensity[nothing], classes=few[nothing]
        ),
        replace(scans[1], points=scans[1].points + np.float32(3.0)),  # after an empty one
        replace(first, points=first.points[half], intensity=first.intensity[half], classes=few[half]),
        replace(first, classes=None),
        replace(first, intensity=np.random.default_rng(0).normal(size=len(first)).astype(np.float32)),
    ]
    grids = to_grids(odd, 0.01)
    # Everything was movable and dropped: no cell is filled, but the source had points.
    grids.append(replace(grids[2], n_points=1000))
    check(grids, coder)


def test_one_frame_and_the_first_of_a_gop_need_no_other(scans) -> None:
    grids = to_grids(scans)
    alone = check(grids[1:2], "context")
    assert unpack(alone[0])[0].motion is None
    later = encode(grids, "context")
    with pytest.raises(ArchiveError, match="first of its GOP"):
        list(decode_grids(later[1:]))


def test_the_content_checksum_catches_what_the_payload_checksum_does_not(scans) -> None:
    (data,) = encode(to_grids(scans[:1]), "context")
    rng = np.random.default_rng(1)
    caught = 0
    for _ in range(10):
        broken = bytearray(data)
        broken[int(rng.integers(88, len(data) - 4))] ^= 1 << int(rng.integers(8))
        broken[-4:] = zlib.crc32(broken[:-4]).to_bytes(4, "little")
        with pytest.raises(ArchiveError):
            list(decode_grids([bytes(broken)]))
        caught += 1
    assert caught == 10


@pytest.mark.parametrize("cut", [0, 3, 60, 200])
def test_truncated_payloads_are_refused(scans, cut) -> None:
    (data,) = encode(to_grids(scans[:1]), "ppmd")
    with pytest.raises(ArchiveError):
        list(decode_grids([data[:cut]]))


def test_headers_that_cannot_be_are_refused(scans) -> None:
    (data,) = encode(to_grids(scans[:1]), "ppmd")
    for place, value in ((0, 130), (1, 255), (2, 10), (3, 1), (11, 255)):
        broken = bytearray(data)
        broken[place] = value
        broken[-4:] = zlib.crc32(broken[:-4]).to_bytes(4, "little")
        with pytest.raises(ArchiveError):
            list(decode_grids([bytes(broken)]))


def test_far_levels_and_full_grids(make_scan) -> None:
    rng = np.random.default_rng(2)
    level = rng.integers(1, 1 << 23, (ROWS, COLUMNS)).astype(np.int32)
    n = ROWS * COLUMNS
    grid = GridSweep("0", 0, "", n, 0.001, row_elevations([]), level, np.zeros(n, np.float32), None)
    check([grid], "context")
    check([grid], "zstd")
