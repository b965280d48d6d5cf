"""Sources: the layouts that scans are recorded in, all behind one contract (``base.Source``)."""

from __future__ import annotations

from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.ingest.sources.base import Source
from salpcc.stages.ingest.sources.kitti_raw import KittiRaw
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.ingest.sources.simulated import Simulated

SOURCES: dict[str, Source] = {
    "semantickitti": SemanticKitti(),
    "kitti_raw": KittiRaw(),
    "simulated": Simulated(),
    "bag": Bag(),
}
