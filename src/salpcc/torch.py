"""Scans of archives for PyTorch: a map-style data set, and orders that are shuffled and still decode each group once.

::

    from salpcc.torch import ScanDataset, ScanStream

    dataset = ScanDataset(["out/archives/00.mcap", "out/archives/01.mcap"])
    dataset[12]["points"]  # (N, 3) float32
    loader = DataLoader(ScanStream(dataset, groups=4, seed=0), batch_size=None, num_workers=2)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, from_numpy
from torch.utils.data import Dataset, IterableDataset, Sampler, get_worker_info

from salpcc.pipeline.decode import DecodeOptions, Layers, check_layers
from salpcc.pipeline.decoded_groups import DecodedGroups
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.residual_code.archive.reader import ArchiveReader

__all__ = ["GroupSampler", "ScanDataset", "ScanStream", "tensors"]


def tensors(scan: Scan) -> dict[str, Tensor]:
    """Return ``points`` (N, 3) float32, ``intensity`` (N,) float32 and, where they are stored, ``classes`` (N,) int64."""
    found = {"points": from_numpy(scan.points.copy()), "intensity": from_numpy(scan.intensity.copy())}
    if scan.classes is not None:
        found["classes"] = from_numpy(scan.classes.astype(np.int64))
    return found


def _check_groups(groups: int) -> None:
    """Refuse less than one group."""
    if groups < 1:
        raise UsageError(f"groups {groups}: at least one is decoded at a time")


class ScanDataset(Dataset[Any]):
    """All scans of some archives, by place. It can be pickled, forked, and asked by several threads.

    Scans are coded in groups of about 8, so whoever takes them in any order decodes a group for each;
    :class:`GroupSampler` and :class:`ScanStream` give orders that do not.
    """

    def __init__(
        self,
        archives: str | Path | Iterable[str | Path],
        layers: Layers = "all",
        transform: Callable[[Scan], Any] = tensors,
        groups: int = 4,
    ) -> None:
        """Open archives; nothing is decoded.

        Args:
            layers: as in :meth:`salpcc.Archive.open`.
            transform: what an item is made of its scan by. The scan's arrays are shared: change none of them.
            groups: groups of scans that stay decoded in memory.

        Raises:
            ArchiveError, UsageError: as in :meth:`salpcc.Archive.open`; less than one group.
        """
        _check_groups(groups)
        self.decoded = DecodedGroups(groups, DecodeOptions(layers))
        paths = [archives] if isinstance(archives, str | Path) else archives
        self.readers = [ArchiveReader(path) for path in paths]
        for reader in self.readers:
            check_layers(reader, layers)
        self.transform = transform
        self.groups: list[range] = []  # places of the scans of each group
        self._places: list[tuple[int, int, int]] = []
        for number, reader in enumerate(self.readers):
            for gop, entries in enumerate(reader.gops):
                if entries:
                    self.groups.append(range(len(self), len(self) + len(entries)))
                    self._places += [(number, gop, place) for place in range(len(entries))]

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> Any:
        number, gop, place = self._places[index]
        return self.transform(self.decoded.scan(self.readers[number], gop, place))


class GroupSampler(Sampler[int]):
    """An order of a data set's scans for a loader without workers: groups are shuffled, and scans among ``groups`` of them.

    A pass decodes each group once, as long as the data set keeps as many groups. The next pass has another order.
    """

    def __init__(
        self, dataset: ScanDataset, groups: int = 4, seed: int = 0, rank: int = 0, ranks: int = 1
    ) -> None:
        """Shuffle by a seed.

        Args:
            rank, ranks: of so many processes that share the groups, which one this is.

        Raises:
            UsageError: there would be no scans: less than one group, or a rank that is none of the ranks.
        """
        _check_groups(groups)
        if not 0 <= rank < ranks:
            raise UsageError(f"rank {rank} of {ranks}: ranks are counted from 0")
        self.dataset, self.groups, self.seed, self.rank, self.ranks = dataset, groups, seed, rank, ranks
        self.epoch = 0
        dataset.decoded.most = max(dataset.decoded.most, groups)

    def __len__(self) -> int:
        return sum(len(group) for group in self._mine())

    def __iter__(self) -> Iterator[int]:
        mine, random = self._mine(), np.random.default_rng((self.seed, self.epoch, self.rank + 1))
        self.epoch += 1
        for start in range(0, len(mine), self.groups):
            places = np.concatenate([np.array(group) for group in mine[start : start + self.groups]])
            yield from random.permutation(places).tolist()

    def _mine(self) -> list[range]:
        order = np.random.default_rng((self.seed, self.epoch)).permutation(len(self.dataset.groups))
        return [self.dataset.groups[place] for place in order[self.rank :: self.ranks]]


class ScanStream(IterableDataset[Any]):
    """The items of a data set in the order of :class:`GroupSampler`; workers of a loader share the groups, none decodes another's."""

    def __init__(self, dataset: ScanDataset, groups: int = 4, seed: int = 0) -> None:
        """Shuffle by a seed; :attr:`epoch` counts passes, and may be set where workers are started anew for each."""
        _check_groups(groups)
        self.dataset, self.groups, self.seed = dataset, groups, seed
        self.epoch = 0

    def __len__(self) -> int:
        return len(self.dataset)

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        rank, ranks = (worker.id, worker.num_workers) if worker else (0, 1)
        order = GroupSampler(self.dataset, self.groups, self.seed, rank, ranks)
        order.epoch = self.epoch
        self.epoch += 1
        for place in order:
            yield self.dataset[place]
