"""Files on this machine and behind URLs (through fsspec), and files that appear only when they are complete.

A location is a ``Path``; that of a URL is an object of universal_pathlib, which answers to the same methods.
What the two kinds cannot do alike is in this file and nowhere else.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit
from uuid import uuid4

from salpcc.schemas.errors import KindError, UsageError
from salpcc.schemas.extras import require

# A put appears there whole, so it needs no other name; listings must not be kept, for other machines write, too.
_OBJECT_STORES = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss"})
_BLOCK = 1 << 22  # bytes that are read ahead from a URL
# The packages behind URLs agree on no class for a lost connection or a refused credential.
_CLIENTS = frozenset(
    {
        "aiohttp",
        "aiobotocore",
        "azure",
        "botocore",
        "fsspec",
        "gcsfs",
        "google",
        "paramiko",
        "requests",
        "s3fs",
    }
)


def location(name: str | Path) -> Path:
    """Return the path of a file name or URL, such as ``s3://bucket/folder``; credentials come from the environment.

    Raises:
        UsageError: nothing here reads such URLs, it holds a password, or it is empty.
        KindError: it is no name.
    """
    if not isinstance(name, str | os.PathLike) and not hasattr(name, "fs"):
        raise KindError(f"{name!r} is no path of a file or folder")
    if name == "":
        raise UsageError("an empty name is no file or folder; the current folder is .")
    if not isinstance(name, str) or "://" not in name:
        return Path(name) if isinstance(name, str) else name
    scheme = name.partition("://")[0]
    if scheme in ("file", "local"):
        return Path(name.partition("://")[2])
    if urlsplit(name).password is not None:
        raise UsageError(f"{scheme}://…: a URL with a password ends up in messages; use the environment")
    require("s3", name)
    from upath import UPath

    make: Any = UPath

    try:
        path = make(name, **({"use_listings_cache": False} if scheme in _OBJECT_STORES else {}))
        _ = path.fs
    except (ImportError, ValueError) as error:
        raise UsageError(f"{name}: {str(error).splitlines()[0]}") from error
    return cast(Path, path)


def is_url(path: Path) -> bool:
    """Tell whether a location is not on this machine."""
    return not isinstance(path, Path)


def remote(path: Path) -> tuple[Any, str]:
    """Return fsspec's file system of a URL, and the name by which that knows it."""
    path_: Any = path
    return path_.fs, path_.path


def there(path: Path) -> bool:
    """Tell whether something has this name; a link to nothing has it, too, such as one to a disk that is not mounted."""
    return path.exists() if is_url(path) else os.path.lexists(path)


@contextmanager
def atomic(path: Path) -> Iterator[BinaryIO]:
    """Open a file that appears under ``path`` only when complete.

    Raises:
        OSError: it cannot be written, such as on a full disk; it names ``path``.
    """
    with atomic_file(path) as part, open(part, "wb") as stream:
        yield stream


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the name of a file on this machine to write; what it holds then appears under ``path``.

    Here: a temporary name beside it, fsync, rename. A URL: a put, under a temporary name where a put can be seen
    half done.

    Raises:
        OSError: as in :func:`atomic`.
    """
    if is_url(path):
        with TemporaryDirectory() as folder:
            yield Path(folder) / path.name
            _put(Path(folder) / path.name, path)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        _sync(part)
        os.replace(part, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        part.unlink(missing_ok=True)
    _sync(path.parent)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _put(part: Path, path: Path) -> None:
    fs, name = remote(path)
    try:
        if urlsplit(str(path)).scheme in _OBJECT_STORES:
            fs.put_file(str(part), name)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            _, half = remote(path.with_name(f".{path.name}.{uuid4().hex}.part"))
            fs.put_file(str(part), half)
            fs.mv(half, name)
    except OSError as error:
        raise OSError(error.errno or errno.EIO, why(error), str(path)) from error


def write_json(path: Path, what: object) -> None:
    """Write a file of indented JSON, atomically."""
    with atomic(path) as stream:
        stream.write(json.dumps(what, indent=1).encode() + b"\n")


def create(path: Path, content: bytes) -> None:
    """Write a small file behind a URL that must not be there yet.

    Raises:
        FileExistsError: it is there.
    """
    fs, name = remote(path)
    fs.pipe_file(name, content, mode="create")


def reading(path: Path) -> BufferedReader:
    """Open a file to be read from front to back, or here and there."""
    if not is_url(path):
        return open(path, "rb")
    fs, name = remote(path)
    return cast(BufferedReader, fs.open(name, "rb", block_size=_BLOCK))


def read_at(path: Path, at: int, length: int) -> bytes:
    """Read bytes ``[at, at + length)``; from a URL in one request."""
    if is_url(path):
        fs, name = remote(path)
        return bytes(fs.cat_file(name, start=at, end=at + length)) if length else b""
    with open(path, "rb") as stream:
        stream.seek(at)
        return stream.read(length)


def walk(folder: Path) -> Iterator[tuple[str, Path, int]]:
    """Yield each file below a folder, sorted: its path there with slashes, its location, its size. Hidden ones are left out."""
    if is_url(folder):
        fs, base = remote(folder)
        found = {
            name[len(base) :].lstrip("/"): int(info.get("size") or 0)
            for name, info in fs.find(base, detail=True).items()
        }
    else:
        files = (
            Path(parent, name) for parent, _, names in os.walk(folder, followlinks=False) for name in names
        )
        found = {file.relative_to(folder).as_posix(): file.stat().st_size for file in files if file.is_file()}
    for name in sorted(found):
        if not any(part.startswith(".") for part in name.split("/")):
            yield name, folder / name, found[name]


def mapped(path: Path) -> mmap.mmap:
    """Map a file into memory; one behind a URL is fetched to a temporary file first."""
    with reading(path) as stream, TemporaryFile() as copy:
        if is_url(path):
            shutil.copyfileobj(stream, copy)
            copy.flush()
            return mmap.mmap(copy.fileno(), 0, access=mmap.ACCESS_READ)
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def remove_tree(path: Path) -> None:
    """Delete a folder and all below it; one that is not there is fine."""
    if not is_url(path):
        shutil.rmtree(path, ignore_errors=True)
    elif path.exists():
        fs, name = remote(path)
        fs.rm(name, recursive=True)


def why(error: BaseException) -> str:
    """Say in one line what is wrong; what comes from a URL has no ``strerror``."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    # Where a key is missing, the message is the key, which the caller names anyway.
    missing = isinstance(error, FileNotFoundError) and " " not in str(error)
    return "No such file" if missing else (str(error) or type(error).__name__).splitlines()[0]


def unreachable(error: BaseException) -> bool:
    """Tell whether what failed is the way to a URL, and not what lies there."""
    if isinstance(error, ConnectionError) or type(error).__module__.partition(".")[0] in _CLIENTS:
        return True
    return error.__cause__ is not None and unreachable(error.__cause__)
