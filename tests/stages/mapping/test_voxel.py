"""Voxels: means, counts and scans by a plain twin; movable things stay apart."""

from __future__ import annotations

import numpy as np

from salpcc.stages.mapping.voxel import Voxels, coarser, fuse, fuse_scan, keys_of

CAR, ROAD, BUILDING = 1, 9, 13


def cloud(seed: int, n: int = 500) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    classes = rng.choice(np.array([CAR, ROAD, BUILDING], np.uint8), n)
    return rng.uniform(-2, 2, (n, 3)), rng.random(n).astype(np.float32), classes


def test_fuse_is_what_a_dictionary_gives() -> None:
    xyz, intensity, classes = cloud(0)
    fused = fuse_scan(xyz, intensity, classes, 0.5)
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, at in enumerate(np.floor(xyz / 0.5).astype(int)):
        groups.setdefault((*at, int(classes[i] == CAR)), []).append(i)
    assert len(fused) == len(groups)
    for k in range(len(fused)):
        at = (*np.floor(fused.xyz[k] / 0.5).astype(int), int(fused.movable[k]))
        members = groups[at]
        np.testing.assert_allclose(fused.xyz[k], xyz[members].mean(axis=0))
        np.testing.assert_allclose(fused.intensity[k], intensity[members].mean(), rtol=1e-5)
        assert fused.count[k] == len(members)
        assert fused.classes[k] in classes[members]


def test_scans_count_scans_and_counts_points() -> None:
    xyz = np.array([[0.01, 0.01, 0.01], [0.02, 0.02, 0.02]])
    one = fuse_scan(xyz, np.ones(2, np.float32), None, 0.1)
    both = fuse(Voxels.together([one, one, one]), 0.1)
    assert (both.count.tolist(), both.scans.tolist()) == ([6], [3])


def test_the_commonest_class_wins() -> None:
    classes = np.array([BUILDING, ROAD, ROAD, ROAD, BUILDING], np.uint8)
    fused = fuse_scan(np.full((5, 3), 0.05), np.zeros(5, np.float32), classes, 0.1)
    assert fused.classes.tolist() == [ROAD]


def test_result_does_not_depend_on_how_scans_are_grouped() -> None:
    scans = [fuse_scan(*cloud(seed), 0.5) for seed in range(4)]
    whole = fuse(Voxels.together(scans), 0.5)
    halves = [fuse(Voxels.together(scans[:2]), 0.5), fuse(Voxels.together(scans[2:]), 0.5)]
    again = fuse(Voxels.together(halves), 0.5)
    np.testing.assert_array_equal(whole.count, again.count)
    np.testing.assert_array_equal(whole.scans, again.scans)
    np.testing.assert_allclose(whole.xyz, again.xyz, atol=1e-12)


def test_coarser_keys_are_keys_of_wider_voxels() -> None:
    xyz, _, _ = cloud(5)
    np.testing.assert_array_equal(coarser(keys_of(xyz, 0.1), 2), keys_of(xyz, 0.2))


def test_nothing_fuses_to_nothing() -> None:
    assert len(fuse(Voxels.together([]), 0.1)) == 0
