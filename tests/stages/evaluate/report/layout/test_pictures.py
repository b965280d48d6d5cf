"""Pictures: what is drawn where."""

from __future__ import annotations

import base64
import io

import numpy as np
import pytest
from matplotlib.image import imread

from salpcc.stages.evaluate.report.layout.pictures import birds_eye, range_image, scan_pictures

RED, GREEN = (255, 0, 0), (0, 255, 0)


def where(image: np.ndarray, colour: tuple[int, int, int]) -> list[tuple[int, int]]:
    return [(int(r), int(c)) for r, c in np.argwhere((image == colour).all(axis=2))]


def test_ahead_is_up_and_left_is_left_from_above() -> None:
    points = np.array([[20, 0, 0], [0, 20, 0]], np.float32)
    image = birds_eye(points, np.array([RED, GREEN], np.uint8))
    ((ahead_row, ahead_column),) = where(image, RED)
    ((left_row, left_column),) = where(image, GREEN)
    assert ahead_row < left_row and left_column < ahead_column


@pytest.mark.filterwarnings("error")
def test_a_point_at_the_end_of_the_world_is_in_no_picture() -> None:
    """Places that no integer holds are left out in silence."""
    points = np.array([[20, 0, 0], [1e38, -3e38, 0], [0, 3e38, 3e38]], np.float32)
    colours = np.array([RED, GREEN, GREEN], np.uint8)
    image = birds_eye(points, colours)
    assert len(where(image, RED)) == 1 and not where(image, GREEN)
    assert where(range_image(points, colours), RED)


def test_the_nearest_point_hides_those_behind_it() -> None:
    points = np.array([[5, 0, 0], [50, 0, 0], [5, 5, -2]], np.float32)
    image = range_image(points, np.array([RED, GREEN, GREEN], np.uint8))
    assert len(where(image, RED)) == 3  # one cell, stretched
    assert len(where(image, GREEN)) == 3


def test_an_exact_scan_is_not_coloured_by_an_error_that_is_not_there() -> None:
    points = np.array([[5, 0, 0], [6, 1, 0]], np.float32)
    classes = np.array([9, 1], np.uint8)
    exact = scan_pictures("00/0", points, np.zeros(2, np.float32), classes)
    moved = scan_pictures("00/0", points, np.array([0, 0.002], np.float32), classes)
    assert "every error is 0" in exact[1].caption and "2.00 mm" in moved[1].caption
    assert "car, road" in exact[0].caption
    assert len(scan_pictures("00/0", points, np.zeros(2, np.float32), None)) == 2


def test_points_without_a_class_can_be_seen() -> None:
    points = np.array([[5, 0, 0], [6, 1, 0]], np.float32)
    picture = scan_pictures("00/0", points, np.zeros(2, np.float32), np.array([0, 1], np.uint8))[0]
    assert "other (grey), car" in picture.caption
    data = base64.b64decode(picture.uri.partition(",")[2])
    image = (255 * imread(io.BytesIO(data))[:, :, :3]).round().astype(np.uint8)
    assert len(where(image, (122, 128, 140))) == 3


def test_nothing_to_draw_is_no_picture() -> None:
    nothing = np.full((3, 3), np.nan, np.float32)
    assert scan_pictures("00/0", nothing, np.zeros(3, np.float32), None) == []
