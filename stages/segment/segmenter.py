"""Label scans with a trained network."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS, GROUPS
from salpcc.stages.segment.back_projection import classes_of_points
from salpcc.stages.segment.class_shares import as_in_streets
from salpcc.stages.segment.inputs import network_input, stack
from salpcc.stages.segment.network import N_CLASSES, SegmentNetwork
from salpcc.stages.segment.point_branch import PointTensors
from salpcc.stages.segment.range_image import RangeImage, project

F32 = NDArray[np.float32]

# Columns repeated at both ends, so that the seam behind the vehicle is seen whole; divides by every fold and level.
SEAM = 64
_MEMBERS = [1 + np.flatnonzero(GROUP_OF_CLASS[1 : N_CLASSES + 1] == group) for group in range(len(GROUPS))]


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What the network says of the pixels of a scan.

    Attributes:
        image: the range image.
        groups: ``(3, 64, W)`` float32, probability of each group; 0 where there is no return.
        best: ``(3, 64, W)`` uint8, the most probable class of each group.
    """

    image: RangeImage
    groups: F32
    best: NDArray[np.uint8]

    def classes(self) -> NDArray[np.uint8]:
        """Class ``(64, W)`` uint8 of each pixel: the best of the most probable group.

        A car torn between two kinds of vehicle is movable all the same.
        """
        return np.take_along_axis(self.best, self.groups.argmax(axis=0)[None], axis=0)[0]

    def labels(self, points: F32) -> NDArray[np.uint8]:
        """Class ``(N,)`` uint8 of every point ``(N, 3)`` of the scan, hidden ones too."""
        return classes_of_points(self.image, self.classes(), points)


def class_scores(
    network: SegmentNetwork, points: F32, intensity: F32, device: str = "cpu"
) -> tuple[RangeImage, F32]:
    """Run the network on points ``(N, 3)`` and intensities ``(N,)`` of one scan, of any sensor.

    Returns the range image and the probability ``(19, 64, W)`` of each class, as trained. On one thread, so that a
    scan gets the same labels however many workers there are.
    """
    image = project(points, intensity)
    if not (image.index >= 0).any():
        return image, np.full((N_CLASSES, *image.index.shape), 1.0 / N_CLASSES, np.float32)
    config = network.config
    features, sets = stack([network_input(image.planes, config.fold, config.n_points, circular=True)])
    features, sets = _with_seam(features, sets, config.fold)
    with torch.inference_mode(), _one_thread():
        logits = network(features.to(device), sets.to(device))[..., SEAM:-SEAM]
        return image, torch.softmax(logits[0].float(), 0).cpu().numpy()


def by_group(image: RangeImage, scores: F32) -> Segmentation:
    """Sum the probabilities ``(19, 64, W)`` of an image's classes up to groups."""
    groups = np.stack([scores[members - 1].sum(axis=0) for members in _MEMBERS])
    best = np.stack([members[scores[members - 1].argmax(axis=0)] for members in _MEMBERS])
    # Rounded, so that the last bits of a processor's arithmetic decide nothing.
    return Segmentation(image, np.rint(groups * 4096) / 4096 * (image.index >= 0), best.astype(np.uint8))


def segment_scan(network: SegmentNetwork, points: F32, intensity: F32, device: str = "cpu") -> Segmentation:
    """Segment one scan, its classes weighed as they occur in streets."""
    image, scores = class_scores(network, points, intensity, device)
    return by_group(image, as_in_streets(scores))


def label_points(
    network: SegmentNetwork, points: F32, intensity: F32, device: str = "cpu"
) -> NDArray[np.uint8]:
    """Return the class ``(N,)`` uint8 of every point of a scan."""
    return segment_scan(network, points, intensity, device).labels(points)


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _with_seam(features: torch.Tensor, sets: PointTensors, fold: int) -> tuple[torch.Tensor, PointTensors]:
    """Repeat the columns at both ends of a whole turn."""
    _, _, height, width = features.shape
    columns = torch.arange(-SEAM, width + SEAM) % width
    folded = torch.arange(-SEAM // fold, (width + SEAM) // fold) % (width // fold)
    pixels = (torch.arange(height)[:, None] * (width // fold) + folded).ravel()
    return features[..., columns], sets._replace(
        pixel_parents=sets.pixel_parents[:, pixels], pixel_weights=sets.pixel_weights[:, pixels]
    )
