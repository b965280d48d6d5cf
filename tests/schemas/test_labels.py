"""Classes and the labels of SemanticKITTI are each other's inverse."""

import numpy as np

from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS, classes_of_labels, labels_of_classes


def test_classes_come_back_from_labels() -> None:
    classes = np.arange(len(CLASSES), dtype=np.uint8)
    again = classes_of_labels(labels_of_classes(classes))
    known = np.array([bool(c.ids) for c in CLASSES])
    assert np.array_equal(again[known], classes[known])
    assert np.array_equal(GROUP_OF_CLASS[again], GROUP_OF_CLASS[classes])
