"""Errors of the project: one root, one subclass per fact.

They live with the schemas because every room raises them; only the command line prints them and
turns them into exit codes. A message is one line that names the file, the scan and the remedy.
"""

from __future__ import annotations


class SalpccError(Exception):
    """Root of every error that a user can cause or mend."""


class UsageError(SalpccError):
    """The command or configuration asks for something that cannot be (exit code 2)."""


class KindError(UsageError, TypeError):
    """An array, or what should be a scan, is of another kind."""


class SourceError(SalpccError):
    """A recorded file is missing, truncated or not what it claims to be."""


class SensorError(SalpccError):
    """A sensor model is unreadable, or does not describe the scans at hand."""


class ShardError(SalpccError):
    """A shard is missing, unreadable or was written by a newer major version."""


class ArchiveError(SalpccError):
    """An archive or a payload in it is damaged, truncated or of an unknown version."""


class DamagedError(ArchiveError):
    """Bytes of an archive are gone or are not what they were; what is whole can be recovered."""


class LockedError(SalpccError):
    """Another run holds the output folder."""


class WorkersDiedError(SalpccError):
    """Workers keep dying of one piece of work; ``reason`` says how often."""

    def __init__(self, what: str, times: int) -> None:
        self.reason = f"workers died {times} times on it (out of memory?)"
        super().__init__(f"{what}: {self.reason}; run the same command with fewer --workers")


class LogWarning(UserWarning):
    """A log is not what its metadata say, or something in it stays behind; one line, said before anything is written."""
