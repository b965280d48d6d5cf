"""Weights of networks: safetensors and NumPy archives."""

from __future__ import annotations

from pathlib import Path

from target import Target

from salpcc.stages.predict.learned import shipped as models
from salpcc.stages.predict.learned.network import load_network
from salpcc.stages.predict.paper.st_lstm import checkpoint
from salpcc.stages.predict.static import count_tables as tables
from salpcc.stages.segment.network.checkpoint import load_weights
from salpcc.stages.segment.weights_file import SHIPPED as SEGMENT

TABLES = tables.WEIGHTS / "fast.npz"
CODER = Path(models.__file__).parent / "weights" / "range_default.npz"


def _segment(_: int, data: bytes, folder: Path) -> None:
    (folder / "a.safetensors").write_bytes(data)
    load_weights(folder / "a.safetensors")


def _st_lstm(_: int, data: bytes, folder: Path) -> None:
    (folder / "a.safetensors").write_bytes(data)
    checkpoint.load(folder / "a.safetensors")


def _coder(_: int, data: bytes, folder: Path) -> None:
    (folder / "a.npz").write_bytes(data)
    load_network(folder / "a.npz")


def _tables(_: int, data: bytes, folder: Path) -> None:
    (folder / "a.npz").write_bytes(data)
    tables.load_tables(folder / "a.npz")


TARGETS = {
    "weights, segment": Target(lambda _: [min(SEGMENT.glob("*.safetensors")).read_bytes()], _segment, 0.005),
    "weights, st_lstm": Target(lambda _: [checkpoint.SHIPPED.read_bytes()], _st_lstm, 0.01),
    "weights, coder": Target(lambda _: [CODER.read_bytes()], _coder, 0.03),
    "weights, tables": Target(lambda _: [TABLES.read_bytes()], _tables, 0.03),
}
