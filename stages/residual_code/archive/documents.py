"""Documents of an archive: canonical JSON, compressed by zlib with a dictionary of what such documents say.

An archive of a scan or two is mostly what stands around them. Most of that is known beforehand: sensors that
models are shipped for, the classes of labels, the texts of messages. ``dictionary.json`` has them; it is part of the format.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

DICTIONARY_FILE = Path(__file__).parent / "dictionary.json"  # made by scripts/archive_dictionary.py
DICTIONARY = DICTIONARY_FILE.read_bytes()
MOST_BYTES = 1 << 26  # of a document


def pack_document(content: Any) -> bytes:
    """Return the bytes of a document; inverse of :func:`unpack_document`."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
    coder = zlib.compressobj(level=9, zdict=DICTIONARY)
    return coder.compress(text) + coder.flush()


# What every document begins with: zlib's head, and the checksum of the dictionary.
MARK = pack_document(None)[:6]


def unpack_document(data: bytes) -> Any:
    """Return the content of a document.

    Raises:
        ValueError: it is damaged, or larger than any that is written.
    """
    decoder = zlib.decompressobj(zdict=DICTIONARY)
    try:
        text = decoder.decompress(data, MOST_BYTES)
    except zlib.error as error:
        raise ValueError(f"a document does not decompress ({error})") from error
    if not decoder.eof or decoder.unused_data:
        raise ValueError(f"a document is truncated, or of more than {MOST_BYTES} bytes")
    return json.loads(text)
