"""Baselines: the codecs that this project is compared with, and itself, under one contract (``baseline.py``)."""

from __future__ import annotations

from collections.abc import Mapping

from salpcc.schemas.errors import UsageError
from salpcc.stages.evaluate.baselines.baseline import Baseline
from salpcc.stages.evaluate.baselines.cloudini import CLOUDINI
from salpcc.stages.evaluate.baselines.draco import DRACO, DRACO_SEQUENTIAL
from salpcc.stages.evaluate.baselines.feng import FENG
from salpcc.stages.evaluate.baselines.generic import BROTLI, BZIP2, XZ, ZSTD
from salpcc.stages.evaluate.baselines.hevc import HEVC_INTER, HEVC_INTRA
from salpcc.stages.evaluate.baselines.laszip import LASZIP
from salpcc.stages.evaluate.baselines.octree import OCTREE
from salpcc.stages.evaluate.baselines.ours import SALPCC
from salpcc.stages.evaluate.baselines.png import PNG
from salpcc.stages.evaluate.baselines.ppmd import PPMD
from salpcc.stages.evaluate.baselines.sun import SUN
from salpcc.stages.evaluate.baselines.tmc13 import TMC13, TMC13_OCTREE, TMC13_OCTREE_ANGULAR

BASELINES: Mapping[str, Baseline] = {
    "salpcc": SALPCC,
    "draco": DRACO,
    "draco_sequential": DRACO_SEQUENTIAL,
    "laszip": LASZIP,
    "octree": OCTREE,
    "tmc13": TMC13,
    "tmc13_octree": TMC13_OCTREE,
    "tmc13_octree_angular": TMC13_OCTREE_ANGULAR,
    "cloudini": CLOUDINI,
    "png": PNG,
    "hevc_intra": HEVC_INTRA,
    "hevc_inter": HEVC_INTER,
    "feng": FENG,
    "sun": SUN,
    "xz": XZ,
    "zstd": ZSTD,
    "brotli": BROTLI,
    "bzip2": BZIP2,
    "ppmd": PPMD,
}


def names(selection: str) -> tuple[str, ...]:
    """Resolve ``all``, ``none`` or ``NAME,NAME`` to names of the registry.

    Raises:
        UsageError: a name is not in the registry.
    """
    if selection == "all":
        return tuple(BASELINES)
    if selection == "none":
        return ()
    asked = tuple(dict.fromkeys(part.strip() for part in selection.split(",") if part.strip()))
    unknown = [name for name in asked if name not in BASELINES]
    if unknown:
        raise UsageError(f"no baseline {', '.join(unknown)}; choose from {', '.join(BASELINES)}, all or none")
    return asked
