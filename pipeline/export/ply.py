"""Write a binary PLY."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.files import atomic


def write_ply(columns: dict[str, NDArray[Any]], path: Path, comments: Sequence[str] = ()) -> None:
    """Write vertices of the named properties ``(N,)``, each with its own type, little endian."""
    from plyfile import PlyData, PlyElement

    length = len(next(iter(columns.values())))
    rows = np.empty(length, [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    with atomic(path) as stream:
        PlyData([PlyElement.describe(rows, "vertex")], byte_order="<", comments=list(comments)).write(stream)
