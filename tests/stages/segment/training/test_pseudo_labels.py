"""The teacher: what boxes say stands, of the rest it says what it is sure of, and nothing of what has labels."""

from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.checkpoint import load_cached
from salpcc.stages.segment.training.labelled import list_labelled, split_labelled
from salpcc.stages.segment.training.pseudo_labels import complete_labels, join_labels
from salpcc.stages.segment.weights_file import weights_path

ROAD, CAR, TRUCK, IN_NO_BOX = 40, 10, 18, 99


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drive")
    simulate_sequence(SimulationConfig(sequence="07", scans=2, seed=3), root, load_sensor("hdl64e"))
    return root


def test_boxes_are_believed_before_the_teacher() -> None:
    boxes = np.array([0, 0, TRUCK | 5 << 16, IN_NO_BOX, IN_NO_BOX, IN_NO_BOX], np.uint32)
    said = np.array([0, ROAD, CAR, ROAD, CAR, 0], np.uint32)
    both = join_labels(boxes, said)
    assert both.tolist() == [0, ROAD, TRUCK | 5 << 16, ROAD, IN_NO_BOX, IN_NO_BOX]


def test_the_teacher_labels_what_nobody_did(drive: Path, tmp_path: Path) -> None:
    refs = list_labelled(drive)
    truth = [np.fromfile(ref.labels or "", np.uint32) for ref in refs]
    boxed = np.where(np.arange(len(truth[1])) % 6 == 0, truth[1], 0).astype(np.uint32)  # a sixth is known
    boxed.tofile(refs[1].labels or "")
    completed = complete_labels(load_cached(weights_path("small")), [refs[1]], tmp_path / "taught", print)
    assert [ref.path for ref in completed] == [refs[1].path]
    labels = np.fromfile(completed[0].labels or "", np.uint32)
    assert np.array_equal(labels[boxed != 0] & 0xFFFF != 0, boxed[boxed != 0] & 0xFFFF != 0)
    assert (labels != 0).mean() > 0.6
    told = (boxed == 0) & (truth[1] != 0) & (labels == ROAD)
    assert told.sum() > 10_000
    assert np.isin(truth[1][told] & 0xFFFF, (40, 44, 48, 49, 60, 72)).mean() > 0.95
    assert complete_labels(load_cached(weights_path("small")), [refs[0]], tmp_path / "none", print) == []
    assert not (tmp_path / "none").exists()


def test_scans_without_labels_want_a_teacher(drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sequences" / "11" / "velodyne"
    folder.mkdir(parents=True)
    (folder / "000000.bin").write_bytes((drive / "sequences/07/velodyne/000000.bin").read_bytes())
    with pytest.raises(SourceError, match="no labelled scans"):
        split_labelled([tmp_path], [])
    ((ref,), _) = split_labelled([tmp_path], [], taught=True)
    assert ref.labels is None
