"""Where the weights of the segmentation network lie, and their digest; reading them needs :mod:`.network.checkpoint`."""

from __future__ import annotations

import hashlib
from pathlib import Path

from salpcc.schemas.errors import SalpccError

SHIPPED = Path(__file__).parent / "weights"


class WeightsError(SalpccError):
    """Weights are missing, unreadable, of a newer version or of another network."""


def weights_path(name: str) -> Path:
    """Return the file that a name stands for: a shipped width such as ``small``, or a file itself."""
    return Path(name) if name.endswith(".safetensors") else SHIPPED / f"segment_{name}.safetensors"


def any_sensor(path: Path) -> Path:
    """Return the weights for clouds of other sensors that lie beside those of a file; where none do, the file itself.

    >>> any_sensor(weights_path("small")).name
    'segment_small_any.safetensors'
    """
    beside = path.with_stem(path.stem + "_any")
    return beside if beside.is_file() else path


def read_weights(path: Path) -> bytes:
    """Read the file.

    Raises:
        WeightsError: it is not there.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        there = (
            ", ".join(sorted(p.stem.removeprefix("segment_") for p in SHIPPED.glob("segment_*"))) or "none"
        )
        raise WeightsError(
            f"{path}: {error.strerror or error}. Weights of the segmentation network that are here: {there}. Train "
            "others with `salpcc-pipeline train segment`, or run with --labels given or --keep-movable"
        ) from error


def weights_digest(path: Path) -> str:
    """Hex SHA-256 of the file, and of the one beside it for other sensors: names the shards of the runs that used it.

    Raises:
        WeightsError: it is not there.
    """
    return hashlib.sha256(b"".join(read_weights(p) for p in sorted({path, any_sensor(path)}))).hexdigest()
