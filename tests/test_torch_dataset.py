"""Scans of archives in PyTorch: every scan as it is in its file, every group decoded once."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from salpcc import encode_scans
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources import SOURCES
from salpcc.torch import GroupSampler, ScanDataset, ScanStream, tensors


@pytest.fixture(scope="module")
def scans(toy_root: Path) -> list[Scan]:
    """8 scans, of two sequences."""
    source = SOURCES["semantickitti"]
    return [source.read(ref, True) for s in ("00", "01") for ref in source.scans(toy_root, s)]


@pytest.fixture(scope="module")
def archives(scans: list[Scan], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """In groups of 2, 2, 1 and of 2, 1."""
    folder = tmp_path_factory.mktemp("torch")
    return [
        encode_scans(part, folder / f"{name}.mcap", name, effort="fast", gop=2, labels="given")
        for name, part in (("00", scans[:5]), ("01", scans[5:]))
    ]


def mean(scan: Scan) -> float:
    return float(scan.points.mean())


def test_items_are_scans(archives: list[Path], scans: list[Scan]) -> None:
    dataset = ScanDataset(archives)
    assert len(dataset) == 8
    for place in (7, 0, 3, 5):
        item, scan = dataset[place], scans[place]
        assert item["points"].dtype == torch.float32 and item["points"].shape == (len(scan), 3)
        assert item["points"].numpy().tobytes() == scan.points.tobytes()
        assert item["intensity"].numpy().tobytes() == scan.intensity.tobytes()
        assert (item["classes"].numpy() == scan.classes).all() and item["classes"].dtype == torch.int64
        item["points"][:] = 0  # an item is the caller's own
        assert dataset[place]["points"].any()
    assert ScanDataset(archives[0])[4]["points"].shape == (len(scans[4]), 3)
    assert pickle.loads(pickle.dumps(dataset))[1]["points"].shape == (len(scans[1]), 3)
    assert "classes" not in tensors(Scan("a", scans[0].points, scans[0].intensity))
    with pytest.raises(UsageError, match="one layer"):
        ScanDataset(archives, layers="static")


def test_a_shuffled_pass_decodes_each_group_once(archives: list[Path], scans: list[Scan]) -> None:
    dataset = ScanDataset(archives, transform=mean)
    order = GroupSampler(dataset, groups=3, seed=1)
    assert len(order) == 8
    passes = []
    for number in (1, 2):
        got = [float(value) for batch in DataLoader(dataset, batch_size=3, sampler=order) for value in batch]
        assert sorted(got) == sorted(mean(scan) for scan in scans)
        # Of the pass before, some may still be held.
        assert dataset.decoded.decoded <= 5 * number
        passes.append(got)
    assert passes[0] != passes[1]
    again = GroupSampler(dataset, groups=3, seed=1)
    assert [mean(scans[place]) for place in again] == passes[0]  # a seed is an order
    assert {tuple(GroupSampler(dataset, groups=5, seed=s)) for s in range(9)} - {tuple(range(8))}


@pytest.mark.parametrize("workers", [0, 2])
def test_workers_share_the_groups(archives: list[Path], scans: list[Scan], workers: int) -> None:
    stream = ScanStream(ScanDataset(archives, transform=mean), groups=2, seed=3)
    got = [float(value) for value in DataLoader(stream, batch_size=None, num_workers=workers)]
    assert sorted(got) == sorted(mean(scan) for scan in scans) and len(stream) == 8
    groups = [range(2), range(2, 4), range(4, 5), range(5, 7), range(7, 8)]
    shares = []
    for rank in (0, 1):
        mine = GroupSampler(stream.dataset, groups=1, seed=3, rank=rank, ranks=2)
        shares.append({next(g for g, group in enumerate(groups) if place in group) for place in mine})
    assert not shares[0] & shares[1] and shares[0] | shares[1] == {0, 1, 2, 3, 4}
    assert np.isclose(sum(got), sum(mean(scan) for scan in scans))


def test_orders_without_scans_are_refused(archives: list[Path]) -> None:
    dataset = ScanDataset(archives)
    for groups in (0, -1):
        for wrong in (ScanStream, GroupSampler):
            with pytest.raises(UsageError, match="at least one"):
                wrong(dataset, groups)
        with pytest.raises(UsageError, match="at least one"):
            ScanDataset(archives, groups=groups)
    with pytest.raises(UsageError, match="rank 3 of 3: ranks are counted from 0"):
        GroupSampler(dataset, rank=3, ranks=3)
