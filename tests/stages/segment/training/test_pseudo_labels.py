"""The teacher: what boxes say stands, of the rest it says what it is sure of, and nothing of what has labels."""

from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.network.checkpoint import load_cached
from salpcc.stages.segment.training.labelled import list_labelled, split_labelled
from salpcc.stages.segment.training.pseudo_labels import Said, complete_labels, join_labels
from salpcc.stages.segment.weights_file import weights_path

ROAD, CAR, BICYCLE, TRUCK, IN_NO_BOX = 40, 10, 11, 18, 99


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drive")
    simulate_sequence(SimulationConfig(sequence="07", scans=2, seed=3), root, load_sensor("hdl64e"))
    return root


def test_boxes_are_believed_before_the_teacher_but_for_parked_bicycles() -> None:
    given = np.array([0, 0, TRUCK | 5 << 16, IN_NO_BOX, IN_NO_BOX, IN_NO_BOX, IN_NO_BOX], np.uint32)
    said = Said(
        np.array([0, ROAD, CAR, ROAD, CAR, 0, BICYCLE], np.uint32), np.array([False] * 6 + [True], np.bool_)
    )
    boxes, every = join_labels(given, said)
    assert boxes.tolist() == [0, 0, TRUCK | 5 << 16, IN_NO_BOX, IN_NO_BOX, IN_NO_BOX, 0]
    assert every.tolist() == [0, ROAD, TRUCK | 5 << 16, ROAD, IN_NO_BOX, IN_NO_BOX, 0]


def test_the_teacher_labels_what_nobody_did(drive: Path, tmp_path: Path) -> None:
    refs = list_labelled(drive)
    truth = np.fromfile(refs[1].labels or "", np.uint32)
    boxed = np.where(np.arange(len(truth)) % 6 == 0, truth, 0).astype(np.uint32)  # a sixth is known
    boxed.tofile(refs[1].labels or "")
    scans = complete_labels(load_cached(weights_path("small")), refs, tmp_path / "taught", print)
    assert scans[0] == refs[0] and [ref.path for ref in scans[1:]] == [refs[1].path] * 2
    assert all(Path(ref.labels or "").is_relative_to(tmp_path) for ref in scans[1:])
    boxes, every = (np.fromfile(ref.labels or "", np.uint32) for ref in scans[1:])
    assert np.array_equal(boxes[boxes != 0], boxed[boxes != 0])
    assert (boxes[boxed != 0] != 0).mean() > 0.99
    assert (every != 0).mean() > 0.6
    told = (boxed == 0) & (truth != 0) & (every == ROAD)
    assert told.sum() > 10_000
    assert np.isin(truth[told] & 0xFFFF, (40, 44, 48, 49, 60, 72)).mean() > 0.95


def test_scans_without_labels_want_a_teacher(drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sequences" / "11" / "velodyne"
    folder.mkdir(parents=True)
    (folder / "000000.bin").write_bytes((drive / "sequences/07/velodyne/000000.bin").read_bytes())
    with pytest.raises(SourceError, match="no labelled scans"):
        split_labelled([tmp_path], [])
    ((ref,), _) = split_labelled([tmp_path], [], taught=True)
    assert ref.labels is None
