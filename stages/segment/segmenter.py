"""Label scans with a trained network."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS, GROUPS
from salpcc.stages.segment.back_projection import classes_of_points
from salpcc.stages.segment.class_shares import as_in_streets
from salpcc.stages.segment.network import N_CLASSES
from salpcc.stages.segment.quantised import LabellingNetwork
from salpcc.stages.segment.range_image import RangeImage, project

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
        return np.take_along_axis(self.best, self.groups.argmax(axis=0)[None], axis=0)[0]

    def labels(self) -> NDArray[np.uint8]:
        """Class ``(N,)`` uint8 of every point of the scan, hidden ones too."""
        return classes_of_points(self.image, self.classes())


def class_scores(network: LabellingNetwork, points: F32, intensity: F32) -> tuple[RangeImage, F32]:
    """Run the network on points ``(N, 3)`` and intensities ``(N,)`` of one scan, of any sensor.

    Returns the range image and the logits ``(64, W, 19)`` of the classes, as trained. On one thread, so that a
    scan gets the same labels however many workers there are.
    """
    image = project(points, intensity)
    if not (image.index >= 0).any():
        return image, np.zeros((*image.index.shape, N_CLASSES), np.float32)
    with torch.inference_mode(), _one_thread():
        return image, network.logits(image.planes)


def by_group(image: RangeImage, scores: F32) -> Segmentation:
    """Sum the probabilities of an image's classes, given as logits ``(64, W, 19)``, up to groups."""
    with torch.inference_mode(), _one_thread():
        probabilities = torch.softmax(torch.from_numpy(scores), 2).numpy()
    return Segmentation(image, *_sums(probabilities, image.index, GROUP_OF_CLASS))


@njit(cache=True)
def _sums(
    probabilities: F32, index: NDArray[np.int32], group_of: NDArray[np.uint8]
) -> tuple[F32, NDArray[np.uint8]]:
    rows, columns, classes = probabilities.shape
    sums = np.zeros((len(GROUPS), rows, columns), np.float32)
    best = np.zeros((len(GROUPS), rows, columns), np.uint8)
    total = np.empty(len(GROUPS), np.float32)
    most = np.empty(len(GROUPS), np.float32)
    for i in range(rows):
        for j in range(columns):
            if index[i, j] < 0:
                continue
            total[:] = 0.0
            most[:] = -1.0
            for k in range(classes):
                p = probabilities[i, j, k]
                group = group_of[k + 1]  # class 0 is never predicted
                total[group] += p
                if p > most[group]:
                    most[group] = p
                    best[group, i, j] = k + 1
            for group in range(len(GROUPS)):
                # Rounded, so that the last bits of a processor's arithmetic decide nothing.
                sums[group, i, j] = np.rint(total[group] * 4096) / 4096
    return sums, best


def segment_scan(network: LabellingNetwork, points: F32, intensity: F32) -> Segmentation:
    """Segment one scan, its classes weighed as they occur in streets."""
    image, scores = class_scores(network, points, intensity)
    return by_group(image, as_in_streets(scores))


def label_points(network: LabellingNetwork, points: F32, intensity: F32) -> NDArray[np.uint8]:
    """Return the class ``(N,)`` uint8 of every point of a scan."""
    return segment_scan(network, points, intensity).labels()


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
