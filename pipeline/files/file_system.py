"""Archives as files for whatever reads through fsspec: ``salpcc://sequences/04/velodyne/000000.bin::out/archives``.

::

    files = fsspec.filesystem("salpcc", fo="out/archives")
    rows = np.frombuffer(files.cat("sequences/04/velodyne/000000.bin"), np.float32).reshape(-1, 4)

``fsspec`` finds this by the entry point in pyproject.toml.
"""

from __future__ import annotations

from datetime import UTC, datetime
from io import BytesIO
from typing import Any

from fsspec import AbstractFileSystem

from salpcc.pipeline.decode import Layers
from salpcc.pipeline.files.tree import ArchiveTree
from salpcc.schemas.files import location


class ArchiveFileSystem(AbstractFileSystem):
    """The files of an archive, or of a folder of archives; read-only."""

    protocol = "salpcc"
    root_marker = ""
    cachable = True  # whoever asks for the same archives again gets the groups that are decoded

    def __init__(
        self,
        fo: str = "",
        target_protocol: str | None = None,
        target_options: dict[str, Any] | None = None,
        layers: Layers = "all",
        gops: int = 4,
        **options: Any,
    ) -> None:
        """Open ``fo``, an archive or a folder of them, or the URL of one.

        Args:
            target_protocol: of ``fo``, as fsspec tells it in a chain of URLs; credentials come from the environment.
            layers: as in :meth:`salpcc.Archive.open`.
            gops: groups of scans that stay decoded in memory.

        Raises:
            ArchiveError, UsageError: as in :class:`~salpcc.pipeline.files.tree.ArchiveTree`.
        """
        super().__init__(**options)
        plain = target_protocol in (None, "file", "local") or "://" in str(fo)
        self.fo = str(fo) if plain else f"{target_protocol}://{fo}"
        self._options = location(self.fo), layers, gops
        self._tree = ArchiveTree(*self._options)

    @property
    def tree(self) -> ArchiveTree:
        """The files as the archives are now: a run may have replaced one since."""
        if self._tree.changed():
            self._tree = ArchiveTree(*self._options)
        return self._tree

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(super()._strip_protocol(path)).strip("/")

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Tell name, type, size and time of a file or folder.

        Raises:
            FileNotFoundError: there is none of that name.
        """
        name = self._strip_protocol(path)
        tree = self.tree
        if file := tree.files.get(name):
            return {"name": name, "type": "file", "size": file.size, "mtime": file.time / 1e9, "mode": 0o444}
        if name in tree.folders:
            return {"name": name, "type": "directory", "size": 0, "mode": 0o555}
        raise FileNotFoundError(f"{name} is not in {self.fo}")

    def ls(self, path: str, detail: bool = True, **_: Any) -> list[Any]:
        """List a folder, or the file that it is; as :meth:`info` tells them, or names."""
        name = self._strip_protocol(path)
        found = [self.info(name)]
        if found[0]["type"] == "directory":
            inside = sorted(self.tree.folders[name])
            found = [self.info(f"{name}/{one}" if name else one) for one in inside]
        return found if detail else [one["name"] for one in found]

    def cat_file(self, path: str, start: int | None = None, end: int | None = None, **_: Any) -> bytes:
        """Return the bytes ``[start, end)`` of a file, or all of it."""
        if self.info(path)["type"] == "directory":
            raise IsADirectoryError(path)
        return self.tree.files[self._strip_protocol(path)].read()[start:end]

    def _open(self, path: str, mode: str = "rb", **_: Any) -> BytesIO:
        if mode != "rb":
            raise PermissionError(f"{path}: archives are read-only here")
        return BytesIO(self.cat_file(path))

    def modified(self, path: str) -> datetime:
        """Tell when the scan of a file was recorded, by the clock of its log."""
        return datetime.fromtimestamp(self.info(path)["mtime"], UTC)

    created = modified
