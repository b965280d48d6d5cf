"""Memory that is freed stays with the process, so that the next scan finds it.

A scan takes some hundred arrays of a megabyte or so. Asked of the system one by one and given back one by one, their pages
cost a sixth of an encoder's time at effort ``fast``.
"""

from __future__ import annotations

import ctypes

# <malloc.h> of glibc; other C libraries have no mallopt, or do as they like.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_ARRAY = 1 << 24  # bytes; larger arrays are asked of the system all the same
_KEPT = 1 << 26


def keep_memory() -> None:
    """Let this process keep up to 64 MB of what it frees. For processes of our own: a library leaves its host alone."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _ARRAY)
        mallopt(_TRIM_THRESHOLD, _KEPT)
