"""The shipped weights by effort level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.network import Network, load_network
from salpcc.stages.predict.learned.range_features import INPUTS

WEIGHTS = Path(__file__).parent / "weights"
EFFORTS = ("default", "max")
_EVALUATED = "walk 2"  # what the digest of an effort says beside its networks: how they are evaluated


@dataclass(frozen=True, eq=False)
class LearnedModels:
    """The two networks of an effort level; ``digest`` names them, and how they are evaluated, in an archive (hex SHA-256).

    ``looks_back``: whether they ask for the sweep before.
    """

    ranges: Network
    intensity: Network
    digest: str
    looks_back: bool


@cache
def load_models(effort: str) -> LearnedModels:
    """Load the weights of ``default`` or ``max``; raises SalpccError for any other effort."""
    if effort not in EFFORTS:
        raise SalpccError(f"effort {effort!r} has no learned weights; it must be one of {', '.join(EFFORTS)}")
    ranges = load_network(WEIGHTS / f"range_{effort}.npz")
    intensity = load_network(WEIGHTS / f"intensity_{effort}.npz")
    digest = sha256(f"{ranges.digest}{intensity.digest}{_EVALUATED}".encode()).hexdigest()
    return LearnedModels(ranges, intensity, digest, len(ranges.first) > INPUTS)
