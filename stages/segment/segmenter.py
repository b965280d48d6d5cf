"""Label scans with a trained network."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS
from salpcc.stages.segment.back_projection import classes_of_points
from salpcc.stages.segment.network.multimodal import N_CLASSES
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.quantised import LabellingNetwork
from salpcc.stages.segment.network.range_image import RangeImage
from salpcc.stages.segment.network.view import view_of
from salpcc.stages.segment.probabilities import group_probabilities

F32 = NDArray[np.float32]


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
        return _best_of_most(self.groups, self.best)

    def labels(self) -> NDArray[np.uint8]:
        """Class ``(N,)`` uint8 of every point of the scan, hidden ones too."""
        return classes_of_points(self.image, self.classes())


@njit(cache=True)
def _best_of_most(groups: F32, best: NDArray[np.uint8]) -> NDArray[np.uint8]:
    count, rows, columns = groups.shape
    out = np.empty((rows, columns), np.uint8)
    for i in range(rows):
        for j in range(columns):
            most = 0
            for group in range(1, count):
                if groups[group, i, j] > groups[most, i, j]:
                    most = group
            out[i, j] = best[most, i, j]
    return out


def class_scores(network: LabellingNetwork, image: RangeImage) -> tuple[RangeImage, F32]:
    """Run the network on a scan's range image.

    Returns the image and the logits ``(64, W, 19)`` of the classes. On one thread, so that a
    scan gets the same labels however many workers there are.
    """
    if not (image.index >= 0).any():
        return image, np.zeros((*image.index.shape, N_CLASSES), np.float32)
    with torch.inference_mode(), _one_thread():
        return image, network.logits(image.planes)


def by_group(image: RangeImage, scores: F32) -> Segmentation:
    """Sum the probabilities of an image's classes, given as logits ``(64, W, 19)``, up to groups."""
    return Segmentation(image, *group_probabilities(scores, image.index, GROUP_OF_CLASS))


def segment_image(network: LabellingNetwork, image: RangeImage) -> Segmentation:
    """Segment a scan on its range image."""
    return by_group(*class_scores(network, image))


def label_points(network: LabellingNetwork, points: F32, intensity: F32) -> NDArray[np.uint8]:
    """Return the class ``(N,)`` uint8 of every point of a scan."""
    return segment_image(network, project(points, intensity, view_of([(points, intensity)]))).labels()


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
