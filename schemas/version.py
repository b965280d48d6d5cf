"""Which release this is."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    VERSION = version("salpcc-pipeline")
except PackageNotFoundError:  # run from a folder that is not installed
    VERSION = "(not installed)"
TOOL = f"salpcc-pipeline {VERSION}"
