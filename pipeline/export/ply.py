"""A binary PLY."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray


def ply_of(columns: dict[str, NDArray[Any]], comments: Sequence[str] = ()) -> bytes:
    """Return the file of vertices of the named properties ``(N,)``, each with its own type, little endian."""
    from plyfile import PlyData, PlyElement

    length = len(next(iter(columns.values())))
    rows = np.empty(length, [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    file = BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<", comments=list(comments)).write(file)
    return file.getvalue()
