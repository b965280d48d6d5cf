"""The command line: one file a group of commands, put together in ``app``."""

from salpcc.pipeline.cli.app import main

__all__ = ["main"]
