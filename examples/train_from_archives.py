"""Train straight from archives: a PyTorch DataLoader over ``salpcc.torch``.

    python examples/train_from_archives.py out/demo/archives/*.mcap

A scan is coded within its group of scans (8 by default). ScanStream shuffles groups, and the scans of a few groups among each
other; the loader's workers share the groups. So every scan is decoded once an epoch.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import torch
from torch.utils.data import DataLoader

from salpcc import Scan
from salpcc.torch import ScanDataset, ScanStream

POINTS = 16384


def item(scan: Scan) -> tuple[torch.Tensor, torch.Tensor]:
    """Return points and intensity ``(POINTS, 4)`` and classes ``(POINTS,)`` of a part of a scan."""
    if len(scan) == 0:  # an empty scan gives a batch nothing but zeros
        return torch.zeros(POINTS, 4), torch.zeros(POINTS, dtype=torch.long)
    pick = np.random.default_rng(len(scan)).choice(len(scan), POINTS, replace=len(scan) < POINTS)
    rows = np.column_stack([scan.points[pick], scan.intensity[pick]])
    classes = scan.classes[pick] if scan.classes is not None else np.zeros(POINTS)
    return torch.from_numpy(rows), torch.from_numpy(classes.astype(np.int64))


def main(paths: list[str]) -> None:
    """Fit a tiny per-point classifier for two epochs, to show that data flow."""
    stream = ScanStream(ScanDataset(paths, transform=item), groups=4, seed=0)
    model = torch.nn.Sequential(torch.nn.Linear(4, 32), torch.nn.ReLU(), torch.nn.Linear(32, 21))
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    for epoch in range(2):
        stream.epoch = epoch  # workers are started anew, so it is told to them
        start, loss = time.perf_counter(), torch.tensor(0.0)
        for rows, classes in DataLoader(stream, batch_size=4, num_workers=2):
            loss = torch.nn.functional.cross_entropy(model(rows).flatten(0, 1), classes.flatten())
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        seconds = time.perf_counter() - start
        print(f"epoch {epoch}: {len(stream)} scans in {seconds:.1f} s, loss {loss.item():.3f}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: train_from_archives.py ARCHIVE...")
    main(sys.argv[1:])
