"""Objects: what hangs together is judged as one, in a scan and from scan to scan."""

import numpy as np
import pytest

from salpcc.schemas.labels import GROUND, MOVABLE, OTHER
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import RANGE
from salpcc.stages.segment.objects import connected, judge_objects, objects_of
from salpcc.stages.segment.registration import as_pose
from salpcc.stages.segment.segmenter import Segmentation

CAR, TRUCK, BUILDING, ROAD = 1, 4, 13, 9
STILL = np.eye(4)


def _road() -> np.ndarray:
    """A level floor 1.7 m below the sensor, on the rings that it would show."""
    azimuth = np.pi * (1 - 2 * (np.arange(2048) + 0.5) / 2048)
    rho = 1.7 / np.tan(np.deg2rad(np.linspace(2.0, 24.0, 50)))
    rho, azimuth = (a.ravel() for a in np.meshgrid(rho, azimuth))
    return np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), np.full(len(rho), -1.7)], 1)


def _board(x: float, y: float, width: float, height: float = 1.5) -> np.ndarray:
    """An upright rectangle across the way, standing on the floor."""
    y, z = np.meshgrid(np.arange(y - width / 2, y + width / 2, 0.02), np.arange(-1.6, height - 1.7, 0.04))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], 1)


def _scan(
    parts: list[tuple[np.ndarray, float]], best: tuple[int, int, int] = (BUILDING, ROAD, CAR)
) -> Segmentation:
    """A scan of parts, each of one probability to be movable, on a road."""
    points = np.concatenate([_road(), *(part for part, _ in parts)])
    movable = np.concatenate(
        [np.full(len(points) - sum(len(p) for p, _ in parts), -1.0), *(np.full(len(p), m) for p, m in parts)]
    )
    image = project(points.astype(np.float32), np.full(len(points), 0.3, np.float32))
    seen = image.index >= 0
    said = np.where(seen, movable[image.index], 0.0)
    groups = np.zeros((3, *seen.shape), np.float32)
    groups[GROUND] = said < 0
    groups[MOVABLE] = np.maximum(said, 0)
    groups[OTHER] = seen * (1 - groups[GROUND] - groups[MOVABLE])
    classes = np.array(best, np.uint8)[:, None, None] * np.ones_like(groups, np.uint8)
    return Segmentation(image, groups, classes)


def _share(one: Segmentation, low: float, high: float) -> float:
    """Share of the upright pixels between two y that are called movable."""
    image = one.image
    upright = (
        (image.index >= 0) & (image.planes[2] > -1.5) & (image.planes[1] > low) & (image.planes[1] < high)
    )
    assert upright.sum() > 20
    return float((one.groups.argmax(axis=0)[upright] == MOVABLE).mean())


def test_half_a_lorry_is_a_lorry() -> None:
    lorry = [(_board(12.0, 1.0, 2.0, 3.0), 0.9), (_board(12.0, -0.9, 1.8, 3.0), 0.2)]
    (judged,) = judge_objects([_scan(lorry)], [None])
    assert _share(judged, -1.7, 1.9) == 1.0


def test_a_car_on_a_guard_rail_is_none() -> None:
    rail = [
        (_board(10.0, -2.5, 4.8, 0.8), 0.05),
        (_board(10.0, 0.1, 0.4, 0.8), 0.7),
        (_board(10.0, 2.6, 4.6, 0.8), 0.05),
    ]
    (judged,) = judge_objects([_scan(rail)], [None])
    assert _share(judged, -4.5, 4.5) == 0.0


@pytest.mark.parametrize(("width", "share"), [(0.5, 0.0), (1.5, 1.0)])
def test_a_splinter_has_to_be_surer_than_a_thing(width: float, share: float) -> None:
    (judged,) = judge_objects([_scan([(_board(9.0, 0.0, width, 1.2), 0.6)])], [None])
    assert _share(judged, -0.2, 0.2) == share


def test_who_surely_stands_before_a_wall_stays() -> None:
    scene = [(_board(10.0, 3.0, 6.0, 1.7), 0.05), (_board(9.9, 1.0, 0.9, 1.7), 0.95)]
    (judged,) = judge_objects([_scan(scene)], [None])
    assert _share(judged, 0.65, 1.35) == 1.0 and _share(judged, 2.0, 5.5) == 0.0


def test_a_piece_of_a_wall_is_the_wall() -> None:
    """However sure the network is: nothing but what it says sets the piece apart."""
    wall = [(_board(10.0, 3.0, 3.96, 1.7), 0.05), (_board(10.0, 0.0, 2.0, 1.7), 0.95), (_board(10.0, -3.0, 3.96, 1.7), 0.05)]  # fmt: skip
    (judged,) = judge_objects([_scan(wall)], [None])
    assert _share(judged, -4.8, 4.8) == 0.0


def test_what_is_too_large_and_movable_is_no_object() -> None:
    tram = [(_board(10.0, 7.0, 13.9, 2.0), 0.9), (_board(10.0, -7.0, 13.9, 2.0), 0.2)]
    found = _scan(tram)
    (judged,) = judge_objects([found], [None])
    assert (judged.groups == found.groups).all()


def test_a_rail_longer_than_any_object_has_no_cars() -> None:
    rail = [(_board(10.0, 7.0, 13.9, 0.8), 0.05), (_board(10.0, -2.0, 4.0, 0.8), 0.7), (_board(10.0, -9.0, 9.9, 0.8), 0.05)]  # fmt: skip
    car = (_board(7.0, 0.0, 1.8, 1.4), 0.6)
    (judged,) = judge_objects([_scan([*rail, car])], [None])
    assert _share(judged, 1.4, 12.0) == 0.0 and _share(judged, -12.0, -1.4) == 0.0
    assert _share(judged, -0.6, 0.6) > 0.9


def test_what_is_long_and_low_is_a_rail() -> None:
    (judged,) = judge_objects([_scan([(_board(8.0, 0.0, 7.0, 0.9), 0.9)])], [None])
    assert _share(judged, -3.4, 3.4) == 0.0
    (judged,) = judge_objects([_scan([(_board(8.0, 0.0, 7.0, 1.9), 0.9)])], [None])
    assert _share(judged, -3.4, 3.4) == 1.0


def test_an_object_has_one_class() -> None:
    lorry = _scan([(_board(12.0, 0.0, 3.0, 3.0), 0.9)])
    left = (lorry.image.planes[1] > 0.5) & (lorry.image.index >= 0)
    lorry.best[MOVABLE, left] = TRUCK
    upright = (lorry.image.index >= 0) & (lorry.groups[MOVABLE] > 0.5) & (lorry.image.planes[2] > -1.5)
    (judged,) = judge_objects([lorry], [None])
    assert set(judged.classes()[upright]) == {CAR}


@pytest.mark.parametrize(("x", "said", "share"), [(11.3, 0.3, 1.0), (11.3, 0.0, 0.0), (14.0, 0.3, 0.0)])
def test_what_is_seen_within_a_van_is_the_van(x: float, said: float, share: float) -> None:
    """Over its low side, between its other three; what lies behind it is not, nor what surely is something else."""
    end = _board(0.0, 11.3, 2.6, 2.2)[:, [1, 0, 2]]
    van = [_board(10.0, 0.0, 6.0, 0.9), end + (0, 3, 0), end - (0, 3, 0), _board(12.6, 0.0, 6.0, 1.8)]
    found = _scan([*((part, 0.9) for part in van), (_board(x, 0.0, 1.0, 2.4), said)])
    (judged,) = judge_objects([found], [None])
    inside = np.linalg.norm(found.image.planes[:2] - np.array([x, 0.0])[:, None, None], axis=0) < 0.52
    inside &= found.image.planes[2] > -1.5
    decided = judged.groups.argmax(axis=0) == MOVABLE
    assert inside.sum() > 20 and decided[inside].mean() == share
    assert decided[~inside].sum() > 500


@pytest.mark.parametrize(("step", "share"), [(STILL, 1.0), (None, 0.0)])
def test_a_doubt_is_settled_by_the_scans_around(step: np.ndarray | None, share: float) -> None:
    doubts = (0.8, 0.4, 0.8)
    found = [_scan([(_board(12.0 - 0.3 * k, 0.0, 1.8), doubt)]) for k, doubt in enumerate(doubts)]
    judged = judge_objects(found, [None, step, step])
    assert _share(judged[1], -0.8, 0.8) == share


@pytest.mark.parametrize(("pace", "share"), [(0.0, 0.0), (0.9, 1.0)])
def test_what_left_its_place_is_movable_in_every_scan(pace: float, share: float) -> None:
    found = [_scan([(_board(9.0 + pace * k, 0.0, 1.5), 0.35)]) for k in range(5)]
    for one in judge_objects(found, [None, *[STILL] * 4]):
        assert _share(one, -0.6, 0.6) == share


def test_a_parked_car_that_the_sensor_passes_has_not_left() -> None:
    found = [_scan([(_board(14.0 - 0.9 * k, 0.0, 1.5), 0.35)]) for k in range(5)]
    ahead = as_pose(np.array([-0.9, 0.0, 0.0, 0.0, 0.0, 0.0]))
    for one in judge_objects(found, [None, *[ahead] * 4]):
        assert _share(one, -0.6, 0.6) == 0.0


def test_parts_are_those_of_a_plain_search() -> None:
    rng = np.random.default_rng(4)
    planes = np.zeros((6, 9, 40), np.float32)
    planes[:3] = np.cumsum(rng.normal(0, 0.1, (3, 9, 40)), axis=2)
    planes[RANGE] = 10.0
    asked = rng.random((9, 40)) < 0.6
    names, count = connected(planes, asked)
    expected = np.full(asked.shape, -1)
    number = 0
    for start in np.argwhere(asked):
        if expected[tuple(start)] >= 0:
            continue
        waiting = [tuple(start)]
        expected[tuple(start)] = number
        while waiting:
            i, j = waiting.pop()
            for a in range(max(i - 2, 0), min(i + 3, 9)):
                for b in (np.arange(j - 2, j + 3) % 40).tolist():
                    near = np.linalg.norm(planes[:3, i, j] - planes[:3, a, b]) < 0.3
                    if asked[a, b] and near and expected[a, b] < 0:
                        expected[a, b] = number
                        waiting.append((a, b))
        number += 1
    assert count == number and (names == expected).all()


def test_nothing_seen_is_nothing_judged() -> None:
    empty = project(np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    blank = np.zeros((3, *empty.index.shape), np.float32)
    one = Segmentation(empty, blank, blank.astype(np.uint8))
    assert len(objects_of(one).weights) == 0
    assert (judge_objects([one, one], [None, STILL])[1].groups == 0).all()
