"""Files appear whole or not at all."""

from pathlib import Path

import pytest

from salpcc.schemas.files import atomic


def test_file_appears_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file"
    with atomic(path) as stream:
        stream.write(b"abc")
        assert not path.exists()
    assert path.read_bytes() == b"abc"
    assert list(path.parent.iterdir()) == [path]


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError), atomic(path) as stream:
        stream.write(b"half")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
