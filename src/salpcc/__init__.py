"""Bit-exact LiDAR archives: what one needs in Python.

::

    from salpcc import Archive, Scan, encode_scans, scan_from_arrays
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from salpcc.pipeline.archive import Archive
    from salpcc.pipeline.encode import encode_scans
    from salpcc.schemas.scan import Scan
    from salpcc.schemas.version import VERSION as __version__
    from salpcc.stages.ingest.arrays import scan_from_arrays

__all__ = ["Archive", "Scan", "__version__", "encode_scans", "scan_from_arrays"]

_HOMES = {
    "Archive": ("salpcc.pipeline.archive", "Archive"),
    "Scan": ("salpcc.schemas.scan", "Scan"),
    "__version__": ("salpcc.schemas.version", "VERSION"),
    "encode_scans": ("salpcc.pipeline.encode", "encode_scans"),
    "scan_from_arrays": ("salpcc.stages.ingest.arrays", "scan_from_arrays"),
}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: the compiler behind it takes longer to load than most commands run."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, its_name = _HOMES[name]
    globals()[name] = value = getattr(import_module(module), its_name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
