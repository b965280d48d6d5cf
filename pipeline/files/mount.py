"""Archives as a folder of this machine, through FUSE."""

from __future__ import annotations

import errno
import os
import stat
from importlib import import_module
from pathlib import Path
from typing import Any

from salpcc.pipeline.decode import Layers
from salpcc.pipeline.files.file_system import ArchiveFileSystem
from salpcc.schemas.errors import ArchiveError, UsageError


def mount(archives: Path, folder: Path, layers: Layers = "all", gops: int = 4) -> None:
    """Show the files of archives in an empty folder until it is unmounted, or the process interrupted.

    Raises:
        UsageError: this machine has no FUSE, or the folder is not there or not empty.
        ArchiveError: an archive is damaged.
    """
    if not folder.is_dir() or any(folder.iterdir()):
        raise UsageError(f"{folder}: name an empty folder")
    files = ArchiveFileSystem(str(archives), layers=layers, gops=gops)
    fuse = _fuse()
    try:
        fuse.FUSE(_operations(fuse, files), str(folder), foreground=True, ro=True, fsname="salpcc")
    except RuntimeError as error:
        raise UsageError(
            f"{folder}: FUSE does not mount here ({error}); it needs /dev/fuse and the right to mount. "
            "`salpcc-pipeline decode --to kitti` writes the files instead"
        ) from error


def _fuse() -> Any:
    """The library. By its name, as it maps one of the system when it is imported, which nothing else here may."""
    try:
        return import_module("mfusepy")
    except OSError as error:
        raise UsageError(
            "mount needs the system's libfuse (Debian, Ubuntu: apt install fuse3; macOS: macFUSE), which was not found. "
            "`salpcc-pipeline decode --to kitti` writes the files instead"
        ) from error


def _operations(fuse: Any, files: ArchiveFileSystem) -> Any:
    class Operations(fuse.Operations):  # type: ignore[misc]
        """What a kernel asks of a file system that is only read."""

        use_ns = True

        def getattr(self, path: str, fh: int | None = None) -> dict[str, Any]:
            try:
                info = files.info(path)
            except FileNotFoundError:
                raise fuse.FuseOSError(errno.ENOENT) from None
            kind = stat.S_IFDIR if info["type"] == "directory" else stat.S_IFREG
            time = round(1e9 * info.get("mtime", 0))
            times = dict.fromkeys(("st_mtime", "st_ctime", "st_atime"), time)
            owner = {"st_uid": os.getuid(), "st_gid": os.getgid(), "st_nlink": 1}
            return {"st_mode": kind | info["mode"], "st_size": info["size"], **times, **owner}

        def readdir(self, path: str, fh: int) -> list[str]:
            return [".", "..", *(name.rpartition("/")[2] for name in files.ls(path, detail=False))]

        def read(self, path: str, size: int, offset: int, fh: int) -> bytes:
            try:
                return files.cat_file(path, offset, offset + size)
            except ArchiveError as error:
                raise fuse.FuseOSError(errno.EIO) from error

    return Operations()
