"""Labels: any uint32 of any points comes back, each scan alone; damage is told; real ones take little."""

import lzma
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE, classes_of_labels
from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.label_files import labels_that_fit
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.residual_code.label_coder import decode_labels, encode_labels, labelled
from salpcc.stages.segment.task import split


@pytest.fixture(scope="module")
def sweep(make_scan, sensor) -> Sweep:
    """A scan with some points off the lattice."""
    scan = make_scan(1, stride=8)
    points = scan.points.copy()
    points[:: len(scan) // 30] = np.nan
    return scan_to_sweep(replace(scan, points=points), sensor)


def comes_back(sweep: Sweep, labels: np.ndarray, sensor) -> bytes:
    on, off = np.split(labels, [len(sweep.laser)])
    coded = encode_labels(replace(sweep, labels=on, stray_labels=off), sensor)
    back = decode_labels(coded, replace(sweep, labels=None, stray_labels=None), sensor)
    assert (back[0].tobytes(), back[1].tobytes()) == (on.tobytes(), off.tobytes())
    assert (back[0].dtype, back[1].dtype) == (np.uint32, np.uint32)
    return coded


@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.sampled_from([1, 2, 3, 64, 65, 5000, 1 << 20]),
    run=st.integers(1, 40),
)
def test_any_labels_come_back(sweep, sensor, seed, kinds, run) -> None:
    rng = np.random.default_rng(seed)
    listed = rng.integers(0, 2**32, kinds, np.uint32)
    labels = np.repeat(listed[rng.integers(0, kinds, len(sweep) // run + 1)], run)[: len(sweep)]
    comes_back(sweep, labels, sensor)


def test_scans_of_nothing_and_of_strays_only(sweep, make_scan, sensor) -> None:
    empty = scan_to_sweep(
        replace(
            make_scan(1, stride=8), points=np.zeros((0, 3), np.float32), intensity=np.zeros(0, np.float32)
        ),
        sensor,
    )
    comes_back(empty, np.zeros(0, np.uint32), sensor)
    rng = np.random.default_rng(0)
    points = rng.normal(0, 20, (500, 3)).astype(np.float32)
    strays = scan_to_sweep(
        replace(make_scan(1, stride=8), points=points, intensity=np.zeros(500, np.float32)), sensor
    )
    assert len(strays.laser) == 0
    assert len(comes_back(strays, np.repeat(rng.integers(0, 2**32, 5, np.uint32), 100), sensor)) < 150


def test_classes_that_are_known_are_not_told_again(sweep, sensor) -> None:
    """A label that is all there is of its class costs nothing; one of several classes is coded without them."""
    rng = np.random.default_rng(2)
    classes = rng.integers(0, 20, len(sweep)).astype(np.uint8)
    on, off = np.split(classes, [len(sweep.laser)])
    known = replace(sweep, classes=on, stray_classes=off)
    labels = classes.astype(np.uint32) * 7 | 1 << 20
    assert len(comes_back(known, labels, sensor)) < len(comes_back(sweep, labels, sensor)) / 3
    coded = comes_back(known, rng.integers(0, 3, len(sweep)).astype(np.uint32), sensor)
    assert coded[0] == 1
    with pytest.raises(ArchiveError, match="there are none"):
        decode_labels(
            comes_back(known, labels, sensor), replace(sweep, classes=None, stray_classes=None), sensor
        )


def test_labels_that_never_change_take_next_to_nothing(sweep, sensor) -> None:
    assert len(comes_back(sweep, np.full(len(sweep), 0x00070028, np.uint32), sensor)) < 60


def test_a_layer_codes_its_own_labels_only(sweep, sensor) -> None:
    """No label of a movable point is in what is coded of the static layer, not even in its list."""
    rng = np.random.default_rng(5)
    labels = np.repeat(
        rng.choice(np.array([40, 50, 252 | 9 << 16, 30 | 77 << 16], np.uint32), len(sweep)), 9
    )[: len(sweep)]
    on, off = np.split(labels, [len(sweep.laser)])
    moves = [GROUP_OF_CLASS[classes_of_labels(part)] == MOVABLE for part in (on, off)]
    static, movable = split(replace(sweep, labels=on, stray_labels=off), sensor, *moves)
    for layer, others in ((static, (252 | 9 << 16, 30 | 77 << 16)), (movable, (40, 50))):
        coded = encode_labels(layer, sensor)
        assert not any(np.uint32(label).tobytes() in coded for label in others)
        back = labelled(replace(layer, labels=None, stray_labels=None), coded, sensor)
        assert (back.labels == layer.labels).all() and (back.stray_labels == layer.stray_labels).all()


def test_damage_is_told(sweep, sensor) -> None:
    rng = np.random.default_rng(3)
    coded = comes_back(sweep, rng.choice(np.array([10, 40, 50], np.uint32), len(sweep)), sensor)
    dice = random.Random(0)
    for cut in (0, 5, 20, len(coded) - 1):
        with pytest.raises(ArchiveError, match="labels"):
            decode_labels(coded[:cut], sweep, sensor)
    for _ in range(50):
        bad = bytearray(coded)
        bad[dice.randrange(len(bad))] ^= 1 << dice.randrange(8)
        with pytest.raises(ArchiveError, match="labels"):
            decode_labels(bytes(bad), sweep, sensor)
    other = replace(sweep, laser=sweep.laser[:-1], tick=sweep.tick[:-1], count=sweep.count[:-1])
    with pytest.raises(ArchiveError, match="labels"):
        decode_labels(coded, other, sensor)


def test_real_labels_take_less_than_a_third_of_xz(real_data: Path, sensor) -> None:
    source = SOURCES["semantickitti"]
    coded = plain = points = 0
    for sequence in ("00", "06"):
        ref = source.scans(real_data / "semantickitti", sequence)[0]
        scan = source.read(ref, False)
        labels = labels_that_fit(ref, len(scan))
        assert labels is not None
        sweep = scan_to_sweep(replace(scan, labels=labels), sensor)
        data = encode_labels(sweep, sensor)
        back = sweep_to_scan(labelled(replace(sweep, labels=None, stray_labels=None), data, sensor), sensor)
        assert back.labels is not None and back.labels.tobytes() == labels.tobytes()
        coded, points = coded + len(data), points + len(scan)
        plain += len(lzma.compress(Path(ref.labels or "").read_bytes(), preset=9))
    assert 8 * coded / points < 0.16
    assert 3 * coded < plain
