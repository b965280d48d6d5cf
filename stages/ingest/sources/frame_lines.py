"""Text files that say something of each frame, one line a frame: times, time stamps, poses."""

from __future__ import annotations

from pathlib import Path

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import why


def frame_lines(path: Path) -> list[str]:
    """Read the lines of a text file by frame number; a blank one is a frame that nothing is known of.

    A byte order mark and what Windows ends lines with are no part of a line; blank lines at the end are none.

    Raises:
        SourceError: unreadable, or no text.
    """
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
    except ValueError as error:
        raise SourceError(f"{path}: no text ({error})") from error
    while lines and not lines[-1]:
        lines.pop()
    return lines
