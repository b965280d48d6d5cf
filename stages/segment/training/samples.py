"""The endless stream of augmented crops that the network is trained on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from salpcc.schemas.labels import CLASSES
from salpcc.schemas.work import ScanRef
from salpcc.stages.segment.network.inputs import NetworkInput, network_input, stack
from salpcc.stages.segment.network.multimodal import NetworkConfig
from salpcc.stages.segment.network.point_branch import PointTensors
from salpcc.stages.segment.network.range_image import COLUMNS, RANGE
from salpcc.stages.segment.training.crops import Crop, cut, distort, mirror
from salpcc.stages.segment.training.labelled import LabelledImage, LabelledScans, read_labelled, sequence_of
from salpcc.stages.segment.training.other_sensors import as_other_sensor
from salpcc.stages.segment.training.recipe import SampleConfig
from salpcc.stages.segment.training.scan_mixing import Instance, instances_of, mix, paste

IGNORED = -1
_BANK = 400  # instances kept of each class
_LEAST_RETURNS = 500
_WHOLE = 0.5  # of the returns of a scan; boxes cover a sixth
_TRIED = 50  # scans, to find one that is not labelled


@dataclass(eq=False)
class Batch:
    """Features, point sets and targets ``(B, 64, w)`` int64 (class or NOT_MOVABLE - 1, -1 where there is no label)."""

    features: Tensor
    sets: PointTensors
    targets: Tensor


class Samples(IterableDataset[Batch]):
    """Batches of crops, drawn by seed; each loader process draws its own."""

    def __init__(
        self,
        refs: list[ScanRef],
        network: NetworkConfig,
        batch: int,
        seed: int,
        config: SampleConfig | None = None,
        donors: Sequence[ScanRef] = (),
    ) -> None:
        super().__init__()
        self.scans = LabelledScans(refs)
        self.network = network
        self.batch = batch
        self.seed = seed
        self.config = config or SampleConfig()
        self.donors = list(donors)
        self._own = InstanceBank()
        self._given = InstanceBank()
        self._banked: set[int] = set()
        names = [sequence_of(ref) for ref in refs if ref.labels is not None]
        # Sequences weigh by the root of their length, so that no single scene rules.
        weights = [0.0 if ref.labels is None else names.count(sequence_of(ref)) ** -0.5 for ref in refs]
        self._weights = np.array(weights) / np.sum(weights)

    def __iter__(self) -> Iterator[Batch]:
        info = get_worker_info()
        rng = np.random.default_rng([self.seed, info.id if info else 0])
        torch.set_num_threads(1)
        while True:
            yield self.draw(rng)

    def draw(self, rng: np.random.Generator) -> Batch:
        """Draw one batch."""
        inputs: list[NetworkInput] = []
        targets = []
        points = self.network.n_points * self.config.width // COLUMNS
        while len(inputs) < self.batch:
            crop = self.crop(rng)
            if (crop.planes[RANGE] > 0).sum() < _LEAST_RETURNS:
                continue
            inputs.append(network_input(crop.planes, self.network.fold, points, circular=False, rng=rng))
            targets.append(crop.classes.astype(np.int64) - 1)
        features, sets = stack(inputs)
        return Batch(features, sets, torch.from_numpy(np.stack(targets)))

    def crop(self, rng: np.random.Generator) -> Crop:
        """Draw one augmented crop."""
        if rng.random() < self.config.unlabelled:
            return self._unlabelled(rng)
        crop = self._plain(rng)
        if rng.random() < self.config.mixed:
            crop = mix(crop, self._plain(rng), COLUMNS, rng)
        if rng.random() < self.config.pasted:
            self._paste(crop, rng)
        if not self.config.distorted:
            return crop
        crop = distort(crop, rng, self.config.turned, self.config.brightened)
        return as_other_sensor(crop, rng) if rng.random() < self.config.other_sensors else crop

    def _plain(self, rng: np.random.Generator) -> Crop:
        number = int(rng.choice(len(self.scans), p=self._weights))
        image = self.scans[number]
        if number not in self._banked:
            self._banked.add(number)
            self._own.add(image, rng)
        labelled = np.flatnonzero((image.classes > 0).any(axis=0))  # boxes cover only what a camera sees
        within = int(rng.choice(labelled)) if len(labelled) else 0
        return self._cut(image, within - int(rng.integers(self.config.width)), rng)

    def _unlabelled(self, rng: np.random.Generator) -> Crop:
        """Draw a crop from anywhere in a scan that is not labelled as a whole, without its labels."""
        image = self.scans[int(rng.integers(len(self.scans)))]
        for _ in range(_TRIED):
            if image.labelled < _WHOLE:
                break
            image = self.scans[int(rng.integers(len(self.scans)))]
        crop = self._cut(image, int(rng.integers(COLUMNS)), rng)
        if rng.random() < 0.5:
            self._paste(crop, rng)
        crop = distort(crop, rng, self.config.turned, self.config.brightened)
        return replace(crop, classes=np.zeros_like(crop.classes))

    def _cut(self, image: LabelledImage, first: int, rng: np.random.Generator) -> Crop:
        crop = cut(image, first, self.config.width)
        crop = mirror(crop, COLUMNS) if self.config.distorted and rng.random() < 0.5 else crop
        return replace(crop, planes=crop.planes.copy(), classes=crop.classes.copy())

    def _paste(self, crop: Crop, rng: np.random.Generator) -> None:
        if (
            self.donors and self.config.from_donors
        ):  # read one by one, as they are needed; only their instances are kept
            self._given.add(read_labelled(self.donors.pop(int(rng.integers(len(self.donors))))), rng)
        for _ in range(int(rng.integers(1, self.config.most_pasted + 1))):
            given = self._given.instances and rng.random() < self.config.from_donors
            instance = (self._given if given else self._own).draw(rng, self.config.kinds)
            if instance is None:
                return
            flip = bool(rng.random() < 0.5)
            for _ in range(12):  # most columns have no room
                if paste(crop, instance, int(rng.integers(self.config.width)), COLUMNS, flip):
                    break


class InstanceBank:
    """Objects to paste, by class; a full class forgets one at random for each new one."""

    def __init__(self) -> None:
        self.instances: dict[int, list[Instance]] = {}

    def add(self, image: LabelledImage, rng: np.random.Generator) -> None:
        """Take in the objects of an image."""
        for instance in instances_of(image):
            kept = self.instances.setdefault(instance.label, [])
            kept.append(instance)
            if len(kept) > _BANK:
                kept.pop(int(rng.integers(len(kept))))

    def draw(self, rng: np.random.Generator, kinds: tuple[float, float, float]) -> Instance | None:
        """Draw one, classes weighed as in :class:`SampleConfig`; None where there are none.

        Cars are plenty; of the others there are a handful each.
        """
        labels = sorted(self.instances)
        if not labels:
            return None
        vehicle, person, other = kinds
        # Buildings and fences that have names are those that may pass for a lorry.
        lorries = dict.fromkeys(("truck", "other-vehicle", "building", "fence"), vehicle)
        known = lorries | {"car": 1.0, "person": person}
        weights = np.array([known.get(CLASSES[label].name, other) for label in labels])
        kept = self.instances[labels[int(rng.choice(len(labels), p=weights / weights.sum()))]]
        return kept[int(rng.integers(len(kept)))]


def loader(samples: Samples, workers: int) -> Iterator[Batch]:
    """Draw batches in ``workers`` processes beside the training (0: in this one)."""
    return iter(
        DataLoader(
            samples,
            batch_size=None,
            num_workers=workers,
            prefetch_factor=4 if workers else None,
            multiprocessing_context="forkserver" if workers else None,
        )
    )
