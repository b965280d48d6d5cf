"""Whether a file has changed since it was read, told without reading it again."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from salpcc.schemas.files import is_url, remote

_TAGS = ("ETag", "etag", "md5Hash", "content_md5", "generation")  # of a content, by which stores know it
_TIMES = ("LastModified", "last_modified", "updated", "mtime", "created")
_REST = 2_000_000_000  # nanoseconds after which no file system gives a change the time of the one before


def mark(path: Path) -> str:
    """Say what changes whenever a file does, without reading it: size, inode and times, or what a URL tells.

    Raises:
        OSError: it is not there.
    """
    if is_url(path):
        fs, name = remote(path)
        return _told(fs.info(name))
    found = path.stat()
    # The change time is the system's own: who sets back the modification time moves it, too.
    return f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns} {found.st_ino}"


def marks(paths: Iterable[Path]) -> dict[Path, str]:
    """Return the :func:`mark` of each path that is there; of URLs by one listing a folder."""
    found: dict[Path, str] = {}
    listings: dict[Path, dict[str, dict[str, Any]]] = {}
    for path in paths:
        with suppress(OSError, KeyError):
            if not is_url(path):
                found[path] = mark(path)
                continue
            if path.parent not in listings:
                fs, name = remote(path.parent)
                listings[path.parent] = {i["name"].rpartition("/")[2]: i for i in fs.ls(name, detail=True)}
            found[path] = _told(listings[path.parent][path.name])
    return found


def at_rest(path: Path) -> bool:
    """Tell whether another content would surely have another :func:`mark`.

    Not so just after a change, for clocks of file systems tick, nor behind a URL that tags no content.
    """
    if is_url(path):
        fs, name = remote(path)
        return any(fs.info(name).get(tag) for tag in _TAGS)
    found = path.stat()
    return time.time_ns() - max(found.st_mtime_ns, found.st_ctime_ns) > _REST


def _told(info: dict[str, Any]) -> str:
    """The tags of a content; where there are none the times, which may be too coarse (see :func:`at_rest`)."""
    told = [info[key] for key in (*_TAGS, *_TIMES) if info.get(key)]
    return f"{info['size']} {[t.timestamp() if isinstance(t, datetime) else t for t in told]}"
