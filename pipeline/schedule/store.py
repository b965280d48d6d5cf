"""The shard store: Arrow IPC files below ``OUT/shards``, named by the digest of all that went into them.

What has a name is complete: shards are written under a temporary name, synced and renamed. So an
interrupted run resumes by asking for names.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.schemas.checksum import content_crc
from salpcc.schemas.errors import ShardError
from salpcc.schemas.files import atomic, reading, remove_tree, why
from salpcc.schemas.shards import facts_of, stamp
from salpcc.schemas.version import TOOL
from salpcc.schemas.work import ShardRef


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
        table = stamp(table, tool=TOOL, digest=ref.digest, content_crc=content_crc(table), **facts)
        table = table.replace_schema_metadata({**table.schema.metadata, _CRC_KEY: _crc_of(table.schema)})
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
            ShardError: missing, damaged, or from a newer major version. What is damaged is deleted, so that the
                same command makes it again.
        """
        return self._read(ref, facts_only=False)

    def together(self, refs: Iterable[ShardRef], schema: pa.Schema) -> pa.Table:
        """Read shards as one table of a schema.

        Raises:
            ShardError: as in :meth:`read`.
        """
        tables = [self.read(ref)[0].replace_schema_metadata(None).cast(schema) for ref in refs]
        return pa.concat_tables([schema.empty_table(), *tables])

    def facts(self, ref: ShardRef) -> dict[str, Any]:
        """Read the facts of a shard only.

        Raises:
            ShardError: as in :meth:`read`.
        """
        return self._read(ref, facts_only=True)[1]

    def found(self, ref: ShardRef) -> dict[str, Any] | None:
        """Return the facts of a shard that was made before, None where it has to be made (again).

        By this an interrupted run, map or localisation goes on where it was; what is damaged is deleted.
        """
        if not self.has(ref):
            return None
        try:
            return self.facts(ref)
        except ShardError:
            return None

    def _read(self, ref: ShardRef, facts_only: bool) -> tuple[pa.Table, dict[str, Any]]:
        try:
            return read_shard(self.root / ref.path, facts_only)
        except ShardError:
            (self.root / ref.path).unlink(missing_ok=True)
            raise

    def drop_sequence(self, sequence: str, stages: Iterable[str]) -> None:
        """Delete the shards of some stages of a sequence."""
        for stage in stages:
            remove_tree(self.root / sequence / stage)
        for folder in (self.root / sequence, self.root):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def sweep(self) -> None:
        """Delete half-written files that a killed run left behind; call with the output locked."""
        for part in self.root.rglob(".*.part"):
            part.unlink(missing_ok=True)


_CRC_KEY = b"salpcc.crc"  # of the facts, which hold the checksum of the content


def _crc_of(schema: pa.Schema) -> bytes:
    facts = b"".join(v for k, v in sorted(schema.metadata.items()) if k != _CRC_KEY)
    return b"%08x" % zlib.crc32(facts)


def read_shard(path: Path, facts_only: bool = False) -> tuple[pa.Table, dict[str, Any]]:
    """Read any shard file: its table (empty where ``facts_only``) and its facts.

    Raises:
        ShardError: missing, damaged, or from a newer major version.
    """
    try:
        with reading(path) as file, pa.ipc.open_file(file) as reader:
            facts = facts_of(reader.schema, str(path))
            table = reader.schema.empty_table() if facts_only else reader.read_all()
            table.validate(full=True)  # offsets that lead out of a buffer crash whoever follows them
            sound = reader.schema.metadata.get(_CRC_KEY) == _crc_of(reader.schema)
            if not sound or not (facts_only or content_crc(table) == facts.get("content_crc")):
                raise ShardError(f"{path}: damaged (checksum differs); run the same command again")
            return table, facts
    except OSError as error:
        raise ShardError(f"{path}: {why(error)}; run the same command again") from error
    except (pa.ArrowException, MemoryError, UnicodeDecodeError, OverflowError) as error:
        raise ShardError(
            f"{path}: damaged ({(str(error) or type(error).__name__).splitlines()[0]}); run the same command again"
        ) from error
