"""Train straight from archives: a PyTorch DataLoader over ``salpcc.pipeline.Archive``.

    python examples/train_from_archives.py out/demo/archives/*.mcap

A scan is coded within its group of pictures (8 scans by default), so shuffling single scans would decode up to
8 scans for each one. The sampler shuffles groups instead and reads each from front to back: every scan is
decoded once an epoch. Workers get their own copy of the archives; an archive holds no open file.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, Sampler

from salpcc import Archive

POINTS = 16384


class ArchiveScans(Dataset[tuple[torch.Tensor, torch.Tensor]]):
    """All scans of some archives: points and intensity ``(POINTS, 4)``, classes ``(POINTS,)``."""

    def __init__(self, paths: list[Path]) -> None:
        self.archives = [Archive.open(path) for path in paths]
        self.places = [(a, i) for a, archive in enumerate(self.archives) for i in range(len(archive))]

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        archive, place = self.places[index]
        scan = self.archives[archive][place]
        if len(scan) == 0:  # an empty scan gives a batch nothing but zeros
            return torch.zeros(POINTS, 4), torch.zeros(POINTS, dtype=torch.long)
        pick = np.random.default_rng(index).choice(len(scan), POINTS, replace=len(scan) < POINTS)
        rows = np.column_stack([scan.points[pick], scan.intensity[pick]])
        classes = scan.classes[pick] if scan.classes is not None else np.zeros(POINTS)
        return torch.from_numpy(rows), torch.from_numpy(classes.astype(np.int64))


class GroupsShuffled(Sampler[list[int]]):
    """Batches of consecutive scans, one group of pictures each, in random order."""

    def __init__(self, dataset: ArchiveScans, seed: int = 0) -> None:
        self.random = np.random.default_rng(seed)
        self.batches: list[list[int]] = []
        start = 0
        for archive in dataset.archives:
            gop = int(archive.config["gop"])
            stop = start + len(archive)
            self.batches += [list(range(i, min(i + gop, stop))) for i in range(start, stop, gop)]
            start = stop

    def __len__(self) -> int:
        return len(self.batches)

    def __iter__(self) -> Iterator[list[int]]:
        for batch in self.random.permutation(len(self.batches)):
            yield self.batches[batch]


def main(paths: list[Path]) -> None:
    """Fit a tiny per-point classifier for two epochs, to show that data flow."""
    dataset = ArchiveScans(paths)
    loader = DataLoader(dataset, batch_sampler=GroupsShuffled(dataset), num_workers=2)
    model = torch.nn.Sequential(torch.nn.Linear(4, 32), torch.nn.ReLU(), torch.nn.Linear(32, 21))
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    for epoch in range(2):
        start, loss = time.perf_counter(), torch.tensor(0.0)
        for rows, classes in loader:
            loss = torch.nn.functional.cross_entropy(model(rows).flatten(0, 1), classes.flatten())
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        seconds = time.perf_counter() - start
        print(f"epoch {epoch}: {len(dataset)} scans in {seconds:.1f} s, loss {loss.item():.3f}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: train_from_archives.py ARCHIVE...")
    main([Path(argument) for argument in sys.argv[1:]])
