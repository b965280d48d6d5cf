"""Who runs it: command line, Dask graph, shard store, and the Python door to archives."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from salpcc.pipeline.archive import Archive
    from salpcc.pipeline.encode import encode_scans
    from salpcc.schemas.scan import Scan

__all__ = ["Archive", "Scan", "encode_scans"]

_HOMES = {
    "Archive": "salpcc.pipeline.archive",
    "Scan": "salpcc.schemas.scan",
    "encode_scans": "salpcc.pipeline.encode",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: the compiler behind it takes longer to load than most commands run."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
