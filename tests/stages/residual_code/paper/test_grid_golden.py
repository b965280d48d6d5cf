"""What our own coders of the paper profile write, pinned: other bytes are another version of the format.

If a test here fails, bump GRID_CODEC (schemas/ARCHIVE.md, section 10). Coders of libraries are free to write other
bytes of the same meaning, and the prediction network's weights name themselves, so neither is in here.
"""

import hashlib

import numpy as np
import pytest

from salpcc.schemas.grid import COLUMNS, ROWS, GridPrediction, GridSweep
from salpcc.stages.residual_code.paper.grid_coder import encode_grid
from salpcc.stages.residual_code.paper.grid_header import GRID_CODEC
from salpcc.stages.residual_code.paper.grid_streams import GridState

# Level ground at the sensor's height, in the regions of two rings; fitting is the encoder's own affair.
PLANES = np.array([(region, -346, 0, 0) for region in range(60, 100)], np.int32)
DIGESTS: dict[str, str] = {
    "context": "5294cdc4b5cdf334b897403f7c72881afa3aee6a138c8702167a38bc01418b83",
    "lizard": "c97043c7e82b5482f7968bda1be13606c2f510a5d12616bcd6999cd6f128c69e",
    "lz5": "ecba2d7c4ba278f9af239f7d15c8f4c83314cbef047c4a17c4168e1ac92d5470",
}


def _sweeps() -> list[GridSweep]:
    """Two frames of rings of ground and a bent wall, all of whole numbers."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    elevation = (2000 - 420 * np.arange(ROWS) - 210).astype(np.int16)
    sweeps = []
    for number in range(2):
        wall = 9000 + 5 * (column % 400) + 7 * ((row * 37 + column * column * (11 + number)) % 13)
        ground = 240_000 // np.maximum(row - 4, 1) + (row * 29 + column * (31 + number)) % 9
        level = np.where((row + column // 3) % 7 == 0, 0, np.minimum(wall, ground)).astype(np.int32)
        filled = level > 0
        classes = np.where(ground < wall, 9, 13).astype(np.uint8)[filled]
        intensity = ((row + column) % 50 / 100).astype(np.float32)[filled]
        n = int(filled.sum())
        sweeps.append(GridSweep("0", 0, "", n + 5, 0.001, elevation, level, intensity, classes))
    return sweeps


@pytest.mark.parametrize("coder", DIGESTS)
def test_bytes_are_those_of_this_version(coder: str) -> None:
    models = GridState(coder)
    data = [encode_grid(sweep, PLANES, GridPrediction(), models).data for sweep in _sweeps()]
    assert data[0][0] == GRID_CODEC == 129
    assert hashlib.sha256(b"".join(data)).hexdigest() == DIGESTS[coder]
