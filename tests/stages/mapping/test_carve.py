"""Carving: a thing that was there for one scan goes, what stands stays, also where it hides what is behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from salpcc.stages.mapping.carve import contradicted, evidence
from salpcc.stages.mapping.view import COLUMNS, ROWS, view_of
from salpcc.stages.mapping.voxel import Voxels, fuse, fuse_scan

ROAD, OTHER = 9, 13


def seen(sensor_x: float, things: list[tuple[float, float]]) -> np.ndarray:
    """Points of a ring wall 20 m around the origin, hidden where a post 1 m wide at ``things`` is nearer."""
    azimuth = np.linspace(-np.pi, np.pi, 2000, endpoint=False)
    elevation = np.radians(np.arange(-10, 6, 0.4))
    a, e = (v.ravel() for v in np.meshgrid(azimuth, elevation))
    ahead = np.column_stack([np.cos(a), np.sin(a)])
    along = sensor_x * ahead[:, 0]
    reach = -along + np.sqrt(along**2 - sensor_x**2 + 400.0)
    for x, y in things:
        off = np.array([x - sensor_x, y])
        distance, side = ahead @ off, ahead @ np.array([-off[1], off[0]]) / np.hypot(*off)
        hit = (distance > 0) & (np.abs(side * np.hypot(*off)) < 0.5)
        reach = np.where(hit, np.minimum(reach, distance), reach)
    return np.column_stack([reach[:, None] * ahead, reach * np.tan(e)]).astype(np.float32)


def drive(things: list[list[tuple[float, float]]], step: float = 1.6) -> tuple[Voxels, list]:
    parts, views = [], []
    for k, there in enumerate(things):
        pose = np.eye(4)
        pose[0, 3] = step * k
        points = seen(step * k, there)
        xyz = points + pose[:3, 3]
        classes = np.full(len(xyz), OTHER, np.uint8)
        parts.append(fuse_scan(xyz, np.zeros(len(xyz), np.float32), classes, 0.1))
        views.append(view_of(points, None, pose))
    return fuse(Voxels.together(parts), 0.1), views


def carved(voxels: Voxels, views: list) -> np.ndarray:
    return contradicted(voxels, *evidence(voxels.xyz, views))


def test_a_passer_by_goes_and_a_post_stays() -> None:
    post = (4.0, 8.0)
    voxels, views = drive([[post, (5.0, -6.0)], [post], [post], [post], [post]])
    gone = carved(voxels, views)
    by = np.linalg.norm(voxels.xyz[:, :2] - [5.0, -6.0], axis=1) < 1.0
    assert by.sum() > 100 and gone[by].mean() > 0.8
    assert gone[~by].mean() < 0.01


def test_one_view_against_it_is_not_enough() -> None:
    voxels, views = drive([[(5.0, -6.0)], []])
    assert not carved(voxels, views).any()


def test_what_most_scans_met_stays() -> None:
    voxels, views = drive([[(5.0, -6.0)]] * 6 + [[]] * 2, step=0.0)
    by = np.linalg.norm(voxels.xyz[:, :2] - [5.0, -6.0], axis=1) < 1.0
    often = by & (voxels.scans >= 5)
    assert often.any() and not carved(voxels, views)[often].any()


def test_what_views_also_end_at_stays() -> None:
    """A rack that half of the views look through, and half end at, though few of the scans had a return in a voxel."""
    voxels, views = drive([[(5.0, -6.0)], [(5.0, -6.0)], [(5.0, -6.0)], [], [], []], step=0.0)
    by = np.linalg.norm(voxels.xyz[:, :2] - [5.0, -6.0], axis=1) < 1.0
    through, met = evidence(voxels.xyz[by], views)
    assert (through >= 3).mean() > 0.8 and (met >= 2).mean() > 0.8
    gone = carved(replace(voxels, scans=np.ones_like(voxels.scans)), views)
    assert gone[by].mean() < 0.05


def test_what_is_called_ground_but_stands_above_it_is_carved() -> None:
    voxels, views = drive([[(5.0, -6.0)], [], [], [], []])
    by = np.linalg.norm(voxels.xyz[:, :2] - [5.0, -6.0], axis=1) < 1.0
    classes = voxels.classes.copy()
    classes[by] = ROAD
    gone = carved(replace(voxels, classes=classes), views)
    low = by & (voxels.xyz[:, 2] < voxels.xyz[by, 2].min() + 0.1)
    assert not gone[low].any() and gone[by & ~low & (voxels.xyz[:, 2] > 0)].mean() > 0.8


def test_nothing_is_known_where_returns_are_missing() -> None:
    """What was dropped of a scan was not looked through, though its neighbours were."""
    points = seen(0.0, [])
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    whole, holed = (view_of(p, None, np.eye(4)) for p in (points, points[np.abs(azimuth) > 0.5]))
    ahead = slice(COLUMNS // 2 - 2, COLUMNS // 2 + 2)
    assert whole.clear[ROWS // 2, ahead].all() and not holed.clear[ROWS // 2, ahead].any()


def test_view_takes_the_nearest_around_and_knows_where_it_knows_nothing() -> None:
    view = view_of(seen(0.0, [(5.0, 0.0)]), None, np.eye(4))
    middle = view.clear[ROWS // 2, COLUMNS // 2]
    assert middle == pytest.approx(500, abs=2)
    assert view.clear[ROWS // 2, COLUMNS // 2 + 200] == pytest.approx(2000, abs=2)
    assert not view.clear[:40].any()  # no beam goes up there


def test_view_follows_the_sensor_during_the_turn() -> None:
    # A post beside a sensor that moves 2 m a turn: at a quarter turn it stood half a metre on.
    motion = np.array([-2.0, 0, 0, 0, 0, 0])
    across, up = np.linspace(-0.1, 0.1, 40), np.linspace(-0.3, 0.3, 200)
    points = np.array([[x, 5.0, z] for x in across for z in up], np.float32)
    still, moving = view_of(points, None, np.eye(4)), view_of(points, motion, np.eye(4))
    assert np.flatnonzero(still.clear.any(axis=0)).mean() == pytest.approx(0.75 * COLUMNS, abs=1)
    turned = np.flatnonzero(moving.clear.any(axis=0)).mean() - 0.75 * COLUMNS
    assert turned == pytest.approx(-np.arctan2(0.5, 5.0) / (2 * np.pi) * COLUMNS, abs=1)
