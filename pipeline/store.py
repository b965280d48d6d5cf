"""The shard store: Arrow IPC files below ``OUT/shards``, named by the digest of all that went into them.

What has a name is complete: shards are written under a temporary name, synced and renamed. So an
interrupted run resumes by asking for names.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.schemas.errors import ShardError
from salpcc.schemas.files import atomic
from salpcc.schemas.shards import facts_of, stamp
from salpcc.schemas.work import ShardRef

try:
    TOOL = f"salpcc-pipeline {version('salpcc-pipeline')}"
except PackageNotFoundError:  # run from a folder that is not installed
    TOOL = "salpcc-pipeline (not installed)"


class ShardStore:
    """Shards of one output folder. Holds a path only, so it travels to workers."""

    def __init__(self, out: Path) -> None:
        self.root = out / "shards"

    def ref(self, sequence: str, stage: str, gop: int, digest: str) -> ShardRef:
        """Name a shard; it need not exist."""
        return ShardRef(f"{sequence}/{stage}/{gop:05d}-{digest[:16]}.arrow", digest)

    def has(self, ref: ShardRef) -> bool:
        """Tell whether the shard is there, complete."""
        return (self.root / ref.path).is_file()

    def write(self, ref: ShardRef, table: pa.Table, facts: dict[str, Any]) -> None:
        """Write a shard, stamped with who made it and with ``facts``."""
        table = stamp(table, tool=TOOL, digest=ref.digest, **facts)
        with (
            atomic(self.root / ref.path) as stream,
            pa.ipc.new_file(
                stream, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")
            ) as writer,
        ):
            writer.write_table(table)

    def read(self, ref: ShardRef) -> tuple[pa.Table, dict[str, Any]]:
        """Read a shard and its facts.

        Raises:
            ShardError: missing, damaged, or from a newer major version.
        """
        return read_shard(self.root / ref.path)

    def facts(self, ref: ShardRef) -> dict[str, Any]:
        """Read the facts of a shard only.

        Raises:
            ShardError: as in :meth:`read`.
        """
        return read_shard(self.root / ref.path, facts_only=True)[1]

    def drop_sequence(self, sequence: str, stages: Iterable[str]) -> None:
        """Delete the shards of some stages of a sequence."""
        for stage in stages:
            shutil.rmtree(self.root / sequence / stage, ignore_errors=True)
        for folder in (self.root / sequence, self.root):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def sweep(self) -> None:
        """Delete half-written files that a killed run left behind; call with the output locked."""
        for part in self.root.rglob(".*.part"):
            part.unlink(missing_ok=True)


def read_shard(path: Path, facts_only: bool = False) -> tuple[pa.Table, dict[str, Any]]:
    """Read any shard file: its table (empty where ``facts_only``) and its facts.

    Raises:
        ShardError: missing, damaged, or from a newer major version.
    """
    try:
        with pa.OSFile(str(path)) as file, pa.ipc.open_file(file) as reader:
            facts = facts_of(reader.schema, str(path))
            return (reader.schema.empty_table() if facts_only else reader.read_all()), facts
    except OSError as error:
        raise ShardError(f"{path}: {error.strerror or error}; run the command again") from error
    except pa.ArrowException as error:
        raise ShardError(
            f"{path}: damaged ({str(error).splitlines()[0]}); delete it and run again"
        ) from error
