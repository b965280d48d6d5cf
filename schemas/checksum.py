"""A checksum of what an Arrow table holds, for Arrow files have none."""

from __future__ import annotations

import zlib

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc


def content_crc(table: pa.Table) -> int:
    """CRC-32 of types, names and values of a table, however they are laid out in memory."""
    crc = zlib.crc32(table.schema.remove_metadata().to_string().encode())
    for column in table.combine_chunks().columns:
        for chunk in column.chunks:
            crc = _crc(chunk, crc)
    return crc


def _crc(array: pa.Array, crc: int) -> int:
    kind = array.type
    if array.null_count:
        crc = zlib.crc32(np.packbits(array.is_valid().to_numpy(zero_copy_only=False)).data, crc)
        if not pa.types.is_nested(kind) and not pa.types.is_null(kind):
            array = array.drop_null()
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        lengths = pc.fill_null(array.value_lengths(), 0).to_numpy(zero_copy_only=False)
        return _crc(array.flatten(), zlib.crc32(np.ascontiguousarray(lengths).data, crc))
    if pa.types.is_primitive(kind):
        values = array.to_numpy(zero_copy_only=False)
        return zlib.crc32(np.ascontiguousarray(values).view(np.uint8).data, crc)
    for value in array.to_pylist():  # texts and payloads: few
        data = value if isinstance(value, bytes) else repr(value).encode()
        crc = zlib.crc32(data, zlib.crc32(b"%d " % len(data), crc))
    return crc
