"""Two layers of a scan: the static one alone is what dropping leaves, both together are the scan to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.layers import both
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.residual_code.gop import decode_gop, encode_gop, encode_layers, layered_scan
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.header import content_crc
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan
from salpcc.stages.segment.task import keep, quantise, split

BOUNDS = [(None, None), (0.01, 0.01), (0.02, None), (None, 0.05), (0.005, 0.05)]


def moves(sweep: Sweep) -> tuple[np.ndarray, np.ndarray]:
    return GROUP_OF_CLASS[sweep.classes] == MOVABLE, GROUP_OF_CLASS[sweep.stray_classes] == MOVABLE


@pytest.fixture(scope="module")
def scans(make_scan) -> list[Scan]:
    """Scans whose strays, of both layers, stand next to returns of both."""
    found = []
    for seed in range(3):
        scan = make_scan(2, stride=8, motion=None) if seed == 2 else make_scan(seed, stride=8)
        rng = np.random.default_rng(seed)
        points, n = scan.points.copy(), len(scan)
        points[rng.choice(n, n // 30, replace=False)] += np.float32(0.0004)
        points[rng.choice(n, 20, replace=False)] = np.nan
        classes = rng.choice(np.array([1, 9, 13], np.uint8), n)
        classes[n // 2 :] = np.repeat(rng.choice([1, 13], n // 20 + 1), 20)[: n - n // 2]
        found.append(replace(scan, points=points, classes=classes))
    return found


@pytest.fixture(scope="module")
def sweeps(scans, sensor) -> list[Sweep]:
    return [scan_to_sweep(scan, sensor) for scan in scans]


def layers_of(sweeps, sensor, bounds=(None, None)):  # type: ignore[no-untyped-def]
    return [split(sweep, sensor, *moves(sweep), bounds) for sweep in sweeps]


def decoded(coded, sensor):  # type: ignore[no-untyped-def]
    models = GopState(sensor)
    for static, (_, movable) in zip(decode_gop([s.data for s, _ in coded], sensor), coded, strict=True):
        yield static, decode_scan(movable.data, sensor, models, static)


@pytest.mark.parametrize("effort", ["fast", "default", "max"])
@pytest.mark.parametrize("bounds", BOUNDS)
def test_both_layers_give_the_scan_back(scans, sweeps, sensor, effort, bounds) -> None:
    pairs = layers_of(sweeps, sensor, bounds)
    coded = encode_layers(pairs, sensor, effort)
    for (static, movable), wanted, scan in zip(decoded(coded, sensor), pairs, scans, strict=True):
        assert content_crc(static) == content_crc(wanted[0])
        assert content_crc(movable) == content_crc(wanted[1])
        back = both(static, movable, sensor)
        assert back.movable is not None
        assert (back.movable == (GROUP_OF_CLASS[scan.classes] == MOVABLE)).all()
        assert (back.classes == scan.classes).all()
        assert back.intensity.tobytes() == scan.intensity.tobytes()
        for which, bound in ((~back.movable, bounds[0]), (back.movable, bounds[1])):
            ours, theirs = back.points[which], scan.points[which]
            if bound is None:
                assert ours.tobytes() == theirs.tobytes()
            else:
                there = ~np.isnan(theirs).any(axis=1)
                off = np.linalg.norm(ours[there].astype(float) - theirs[there], axis=1)
                assert off.max() <= bound
        part = layered_scan(static, movable, sensor, alone=True)
        assert part.points.tobytes() == back.points[back.movable].tobytes()


@pytest.mark.parametrize("bound", [None, 0.01])
def test_the_static_layer_is_what_dropping_leaves(sweeps, sensor, bound) -> None:
    dropped = [keep(sweep, sensor, *(~which for which in moves(sweep))) for sweep in sweeps]
    dropped = dropped if bound is None else [quantise(sweep, sensor, bound) for sweep in dropped]
    alone = [payload.data for payload in encode_gop(dropped, sensor, "fast")]
    coded = encode_layers(layers_of(sweeps, sensor, (bound, bound)), sensor, "fast")
    assert [static.data for static, _ in coded] == alone
    for static, movable in coded:
        assert sum(movable.sizes.values()) == len(movable.data)
        assert sum(static.sizes.values()) == len(static.data)


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("bound", [None, 0.02])
def test_an_empty_layer(scans, sensor, share, bound) -> None:
    classes = np.full(len(scans[0]), 1 if share else 9, np.uint8)
    scan = replace(scans[0], classes=classes)
    pairs = layers_of([scan_to_sweep(scan, sensor)], sensor, (bound, bound))
    ((static, movable),) = decoded(encode_layers(pairs, sensor, "default"), sensor)
    back = both(static, movable, sensor)
    assert back.movable.mean() == share and len(back) == len(scan)
    assert bound or back.points.tobytes() == scan.points.tobytes()


@pytest.mark.parametrize("bound", [None, 0.01])
def test_scans_without_a_lattice(sensor, bound) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(0, 20, (500, 3)).astype(np.float32)
    classes = rng.choice(np.array([1, 13], np.uint8), 500)
    scan = Scan("x", points, rng.random(500).astype(np.float32), classes=classes)
    pairs = layers_of([scan_to_sweep(scan, sensor)], sensor, (bound, bound))
    ((static, movable),) = decoded(encode_layers(pairs, sensor, "fast"), sensor)
    back = both(static, movable, sensor)
    assert (back.classes == classes).all() and back.intensity.tobytes() == scan.intensity.tobytes()
    assert np.linalg.norm(back.points - points, axis=1).max() <= (bound or 0.0)


def test_a_layer_is_taken_for_no_other(sweeps, sensor) -> None:
    """Neither a movable payload for a scan, nor a static one for a movable layer, nor that of another scan."""
    pairs = layers_of(sweeps, sensor)
    coded = encode_layers(pairs, sensor, "fast")
    with pytest.raises(ArchiveError, match="another layer"):
        list(decode_gop([coded[0][1].data], sensor))
    with pytest.raises(ArchiveError, match="another layer"):
        decode_scan(coded[0][0].data, sensor, GopState(sensor), pairs[0][0])
    with pytest.raises(ArchiveError):
        both_of_others = decode_scan(coded[0][1].data, sensor, GopState(sensor), pairs[1][0])
        layered_scan(pairs[1][0], both_of_others, sensor)


def test_places_that_cannot_be_are_refused(sweeps, sensor) -> None:
    static, movable = layers_of(sweeps, sensor)[0]
    assert len(static.stray_index) > 1
    for lead in (movable.lead[::-1].copy(), np.full_like(movable.lead, len(movable.laser) + 1)):
        with pytest.raises(ArchiveError):
            both(static, replace(movable, lead=lead), sensor)


def test_sweep_of_a_layer_is_of_its_points(sweeps, sensor) -> None:
    """What is neither returned nor astray is in no layer."""
    for sweep, (static, movable) in zip(sweeps, layers_of(sweeps, sensor), strict=True):
        assert len(static) + len(movable) == len(sweep) == len(sweep_to_scan(sweep, sensor))
