"""Files that never take the place of others: what is there may be the recording itself."""

from __future__ import annotations

from pathlib import Path

from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic, is_url, there


def write_new(path: Path, data: bytes, what: str) -> None:
    """Write a file, or find it there as it is to be.

    Raises:
        UsageError: another is there; ``what`` it holds, with its verb, is said.
        OSError: it cannot be written.
    """
    found = path.is_file()
    if found and path.read_bytes() == data:
        return
    if found or (not is_url(path) and path.is_symlink()):
        raise UsageError(f"{path}: other {what} there; name an empty folder with --out")
    with atomic(path) as stream:
        stream.write(data)


def check_new(*paths: Path) -> None:
    """Refuse to write files of which one is there.

    Raises:
        UsageError: it is there.
    """
    for path in paths:
        if there(path):
            raise UsageError(f"{path}: exists, and may be the log itself; name another folder with --out")
