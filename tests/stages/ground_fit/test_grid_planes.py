"""Planes of the range image: what they predict, and where there are none."""

import numpy as np

from salpcc.schemas.grid import COLUMNS, ROWS, GridSweep
from salpcc.schemas.labels import CLASSES
from salpcc.stages.ground_fit.grid_planes import fit_ground, predict_ground
from salpcc.stages.ground_fit.grid_regions import REGIONS, region_image
from salpcc.stages.ingest.paper_grid import directions, row_elevations

ROAD = next(i for i, c in enumerate(CLASSES) if c.name == "road")
CAR = next(i for i, c in enumerate(CLASSES) if c.name == "car")
ELEVATION = row_elevations([])


def _sloping(accuracy: float, noise: float = 0.0) -> np.ndarray:
    """Levels of a slope of 3 % to the front, 1.7 m below the sensor, up to 50 m."""
    beams = directions(ELEVATION)
    fall = beams[:, 2] - 0.03 * beams[:, 0]
    with np.errstate(divide="ignore"):
        reach = np.where(fall < 0, -1.7 / fall, np.inf)
    reach += noise * np.random.default_rng(0).normal(size=len(reach))
    level = np.where(reach < 50, np.rint(np.where(reach < 50, reach, 1) / accuracy), 0)
    return level.reshape(ROWS, COLUMNS).astype(np.int32)


def _sweep(level: np.ndarray, classes: np.ndarray | None, accuracy: float = 0.001) -> GridSweep:
    n = int((level > 0).sum())
    return GridSweep("0", 0, "velodyne", n, accuracy, ELEVATION, level, np.zeros(n, np.float32), classes)


def test_a_slope_is_predicted() -> None:
    level = _sloping(0.001, noise=0.01)
    planes = fit_ground(_sweep(level, np.full((level > 0).sum(), ROAD, np.uint8)))
    predicted = predict_ground(planes, ELEVATION, 0.001)
    seen = (level > 0) & (level < 20_000)
    assert (predicted[seen] > 0).all()
    assert np.median(np.abs(predicted[seen] - level[seen])) < 30


def test_regions_are_known_before_ranges() -> None:
    regions = region_image(ELEVATION)
    assert regions.min() >= 0 and regions.max() < REGIONS
    assert len(np.unique(regions)) > 100


def test_too_little_ground_has_no_plane() -> None:
    level = np.zeros((ROWS, COLUMNS), np.int32)
    level[40, 100:102] = 8000
    planes = fit_ground(_sweep(level, np.full(2, ROAD, np.uint8)))
    assert planes.shape == (0, 4)
    assert not predict_ground(planes, ELEVATION, 0.001).any()


def test_no_ground_and_no_classes_have_no_planes() -> None:
    level = _sloping(0.01)
    n = int((level > 0).sum())
    assert len(fit_ground(_sweep(level, np.full(n, CAR, np.uint8), 0.01))) == 0
    assert len(fit_ground(_sweep(level, None, 0.01))) == 0
    assert len(fit_ground(_sweep(np.zeros((ROWS, COLUMNS), np.int32), np.zeros(0, np.uint8)))) == 0
