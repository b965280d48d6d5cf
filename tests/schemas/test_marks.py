"""A file that changes changes its mark."""

import os
import time
from pathlib import Path

from salpcc.schemas.files import location
from salpcc.schemas.marks import at_rest, mark, marks


def test_another_content_has_another_mark(tmp_path: Path) -> None:
    for folder in (tmp_path, location("memory://marks")):
        path = folder / "file"
        path.write_bytes(b"0123456789")
        before = marks([path, folder / "nothing"])
        assert before == {path: mark(path)}
        assert not at_rest(path)  # too fresh here, and memory tags no content
        time.sleep(0.02)
        path.write_bytes(b"9876543210")
        assert mark(path) != before[path]


def test_who_sets_back_the_modification_time_is_found(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"one")
    before, times = mark(path), path.stat()
    time.sleep(0.02)
    path.write_bytes(b"two")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert path.stat().st_mtime_ns == times.st_mtime_ns and mark(path) != before
