"""Who runs it: command line, Dask graph, shard store, and the Python door to archives (that of ``salpcc`` itself)."""

from typing import TYPE_CHECKING, Any

import salpcc

if TYPE_CHECKING:
    from salpcc import Archive, Scan, encode_scans

__all__ = ["Archive", "Scan", "encode_scans"]


def __getattr__(name: str) -> Any:
    """Look next door, where it is imported when it is asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(salpcc, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
