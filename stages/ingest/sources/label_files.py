"""``.label`` files: one uint32 a point, its class in the lower 16 bits, its instance in the upper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import location, why
from salpcc.schemas.work import ScanRef


def labels_that_fit(ref: ScanRef, n_points: int) -> NDArray[np.uint32] | None:
    """Read the labels ``(N,)`` of a scan; None where there are none, or not one for each of its points.

    Raises:
        SourceError: the file cannot be read.
    """
    if ref.labels is None:
        return None
    data = label_file(ref.labels)
    return np.frombuffer(data, "<u4").astype(np.uint32) if len(data) == 4 * n_points else None


def label_file(path: str) -> bytes:
    """Read a ``.label`` file.

    Raises:
        SourceError: it cannot be read.
    """
    try:
        return location(path).read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
