"""Labels come back to every point."""

import numpy as np

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.back_projection import classes_of_points
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import COLUMNS


def test_shown_points_take_their_pixel_and_hidden_ones_their_like() -> None:
    wall = np.array([[20, y, z] for y in np.arange(-1, 1, 0.05) for z in np.arange(-2, 0, 0.1)])
    car = np.array([[10, y, z] for y in np.arange(-0.2, 0.2, 0.02) for z in np.arange(-1, -0.2, 0.05)])
    points = np.concatenate([car, wall, [[np.nan, 0, 0]]]).astype(np.float32)
    image = project(points, np.zeros(len(points), np.float32))
    truth = np.repeat([1, 13, 0], [len(car), len(wall), 1])
    classes = np.where(image.index >= 0, truth[image.index], 0).astype(np.uint8)
    found = classes_of_points(image, classes)
    hidden = np.setdiff1d(np.arange(len(points)), image.index)
    assert (truth[hidden] == 13).sum() > 20
    assert (found == truth)[np.setdiff1d(np.arange(len(points)), hidden)].all()
    # The rest lies behind the middle of the car, where no pixel of the wall is near enough to vote.
    assert (found == truth)[hidden].mean() > 0.7
    assert found[-1] == 0


def test_the_seam_is_no_border() -> None:
    cone = load_sensor("hdl64e")
    rho = np.array([10.0, 20.0, 20.0])
    z = cone.z0[20] + rho * np.tan(cone.theta[20])
    points = np.stack([-rho, [0.001, -0.001, 0.002], z], 1).astype(np.float32)
    image = project(points, np.zeros(3, np.float32))
    classes = np.zeros(image.index.shape, np.uint8)
    classes[image.row[0], image.column[0]] = 1
    classes[image.row[1], image.column[1]] = 13
    assert image.column.tolist() == [0, COLUMNS - 1, 0]
    assert classes_of_points(image, classes).tolist() == [1, 13, 13]
