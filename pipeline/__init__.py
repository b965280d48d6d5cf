"""Who runs it: command line, Dask graph, shard store, and the Python door to archives."""

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.encode import encode_scans
from salpcc.schemas.scan import Scan

__all__ = ["Archive", "Scan", "encode_scans"]
