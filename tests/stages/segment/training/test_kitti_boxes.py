"""KITTI's own layouts: boxes become partial labels, which are trained on and scored beside SemanticKITTI's."""

from pathlib import Path

import numpy as np
import pytest
import torch

from salpcc.schemas.errors import SourceError
from salpcc.stages.segment.network.multimodal import WIDTHS
from salpcc.stages.segment.network.range_image import RANGE
from salpcc.stages.segment.training.crops import Crop
from salpcc.stages.segment.training.kitti_boxes import labels_of_boxes, list_boxed
from salpcc.stages.segment.training.labelled import (
    NOT_MOVABLE,
    list_labelled,
    read_labelled,
    sequence_of,
    split_labelled,
)
from salpcc.stages.segment.training.losses import lovasz, segmentation_loss
from salpcc.stages.segment.training.recipe import SampleConfig
from salpcc.stages.segment.training.samples import Samples
from salpcc.stages.segment.training.scan_mixing import instances_of, paste
from salpcc.stages.segment.training.score import count, scores

CAMERA = """P2: 700 0 600 0 0 700 180 0 0 0 1 0
{rectify} 1 0 0 0 1 0 0 0 1
{carry} 0 -1 0 0 0 0 -1 0 1 0 0 0
"""
# A car of 4 x 1.6 x 1.5 m that drives ahead, 10 m before the sensor, on ground 1.7 m below it.
CAR = "Car 0 0 0 500 150 700 250 1.5 1.6 4.0 0 1.7 10 -1.5707963"
IGNORED = "DontCare -1 -1 -10 0 0 100 370 -1 -1 -1 -1000 -1000 -1000 -10"


def _points() -> np.ndarray:
    """A floor around the sensor, and the rear of the car with what is on it."""
    azimuth = np.arange(2048) / 2048 * 2 * np.pi
    rho, azimuth = (
        a.ravel() for a in np.meshgrid(1.7 / np.tan(np.deg2rad(np.linspace(3.0, 23.0, 70))), azimuth)
    )
    floor = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), np.full(len(rho), -1.7)], 1)
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-0.75, 0.76, 0.03), np.arange(-1.65, -0.25, 0.03)))
    return np.concatenate([floor, np.stack([np.full(len(y), 8.05), y, z], 1)]).astype(np.float32)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.fixture
def objects(tmp_path: Path) -> Path:
    base = tmp_path / "objects" / "training"
    _write(base / "calib" / "000007.txt", CAMERA.format(rectify="R0_rect:", carry="Tr_velo_to_cam:"))
    _write(base / "label_2" / "000007.txt", f"{IGNORED}\n{CAR}\n")
    (base / "velodyne").mkdir()
    np.column_stack([_points(), np.full(len(_points()), 0.3)]).astype("<f4").tofile(
        base / "velodyne" / "000007.bin"
    )
    return base.parent


@pytest.fixture
def tracking(tmp_path: Path) -> Path:
    base = tmp_path / "tracking" / "training"
    _write(base / "calib" / "0003.txt", CAMERA.format(rectify="R_rect", carry="Tr_velo_cam"))
    _write(
        base / "label_02" / "0003.txt",
        f"0 -1 {IGNORED}\n0 4 {CAR}\n1 4 {CAR.replace('10 -1.57', '60 -1.57')}\n",
    )
    (base / "velodyne" / "0003").mkdir(parents=True)
    for k in range(3):
        rows = np.column_stack([_points(), np.full(len(_points()), 0.3)]).astype("<f4")
        rows.tofile(base / "velodyne" / "0003" / f"{k:06d}.bin")
    return base.parent


def test_a_box_is_an_instance_with_a_rim_that_teaches_nothing(objects: Path) -> None:
    (ref,) = list_boxed(objects)
    points = _points()
    labels = labels_of_boxes(ref, points)
    car = points[:, 0] == np.float32(8.05)
    assert (labels[car & (points[:, 2] > -1.59)] == 10 | 2 << 16).all()  # the second line
    assert (labels[car & (points[:, 2] < -1.61)] == 0).all()
    around = ~car & (np.abs(points[:, 0] - 10) < 2.25) & (np.abs(points[:, 1]) < 1.05)
    assert around.sum() > 20 and (labels[around] == 0).all()
    assert (labels[points[:, 0] < 0] == 0).all()  # behind the camera
    across = 600 - 700 * points[:, 1] / points[:, 0]
    seen = (points[:, 0] > 12.5) & (across < 1200)
    assert (labels[seen & (across > 105)] == 99).all() and (
        labels[seen & (across > 0) & (across < 95)] == 0
    ).all()


def test_tracks_are_instances_and_frames_without_boxes_have_none(tracking: Path) -> None:
    first, second, third = (read_labelled(ref) for ref in list_boxed(tracking))
    assert np.unique(first.instances).tolist() == [0, 10 | 5 << 16]
    assert not second.instances.any() and not third.instances.any()
    assert (third.classes == NOT_MOVABLE).sum() > (first.classes == NOT_MOVABLE).sum() > 1000
    assert {sequence_of(ref) for ref in list_boxed(tracking)} == {"0003"}


def test_any_mix_of_layouts_is_split_by_sequence_and_by_scan(
    objects: Path, tracking: Path, toy_root: Path
) -> None:
    rest, held = split_labelled([toy_root, objects, tracking], ["00", "0003/000001", "training/000007"])
    assert [ref.name for ref in held if "tracking" in ref.path] == ["000001"]
    assert [ref.name for ref in held if "objects" in ref.path] == ["000007"]
    assert {sequence_of(ref) for ref in rest} == {"01", "0003"}
    assert len(rest) + len(held) == sum(len(list_labelled(root)) for root in (toy_root, objects, tracking))


@pytest.mark.parametrize(
    ("file", "text", "hint"),
    [
        ("label_2/000007.txt", "Car 0 0 0 1 2", "line 1, .* is not a box"),
        ("label_2/000007.txt", CAR.replace("Car", "Kart"), "is not a box"),
        ("calib/000007.txt", "P2: 1 2 3", "not a calibration"),
        ("calib/000007.txt", None, "No such file"),
    ],
)
def test_broken_files_are_named(objects: Path, file: str, text: str | None, hint: str) -> None:
    path = objects / "training" / file
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(SourceError, match=f"{path.name}: .*{hint}"):
        read_labelled(list_boxed(objects)[0])


def test_crops_of_boxes_show_what_is_labelled_and_take_pasted_cars(objects: Path) -> None:
    image = read_labelled(list_boxed(objects)[0])
    config = SampleConfig(width=128, mixed=0.0, pasted=0.0, distorted=False)
    samples = Samples(list_boxed(objects), WIDTHS["small"], 1, 0, config)
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert (samples.crop(rng).classes > 0).any()
    (car,) = instances_of(image)
    behind = Crop(image.planes[:, :, :256].copy(), image.classes[:, :256].copy(), 0)
    assert not behind.classes.any()
    shown = [paste(behind, car, column, image.classes.shape[1], False) for column in (20, 90, 160)]
    assert (
        any(shown)
        and (behind.classes == 1).sum() > 50
        and (behind.planes[RANGE][behind.classes == 1] < 10).all()
    )


def test_not_movable_is_minus_log_of_all_that_is_not() -> None:
    logits = torch.randn(1, 19, 2, 3)
    targets = torch.full((1, 2, 3), NOT_MOVABLE - 1)
    chances = torch.softmax(logits, 1)[:, 8:].sum(1)
    loss = segmentation_loss(logits, targets, torch.ones(19))
    assert torch.allclose(loss, -torch.log(chances).mean(), atol=1e-5)
    logits[:, :8] -= 50.0
    assert segmentation_loss(logits, targets, torch.ones(19)) < 1e-5
    # It counts against movable alone: whether it is called ground or other is all one.
    said = torch.tensor([[0.9, 0.1, 0.0], [0.1, 0.9, 0.0], [0.0, 0.1, 0.9], [0.0, 0.1, 0.9]])
    known = torch.tensor([0, 1, 2, 3])
    assert abs(lovasz(said, known) - (lovasz(said[:3], known[:3]) * 3 - 0.1 + 0.5) / 3) < 1e-6


def test_boxes_are_scored_on_movables_only() -> None:
    labels = np.array([10, 10, 99, 99, 0], np.uint32)
    found = scores(count(labels, np.array([1, 13, 1, 9, 1], np.uint8)))
    assert found["movable"] == 1 / 3 and found["precision_movable"] == 0.5 and np.isnan(found["ground"])
    assert np.isnan(found["other"]) and np.isnan(found["miou"])
    whole = scores(count(np.append(labels, 40).astype(np.uint32), np.array([1, 13, 1, 9, 1, 9], np.uint8)))
    assert whole["movable"] == 0.5 and whole["precision_movable"] == 1.0 and whole["ground"] == 1.0
