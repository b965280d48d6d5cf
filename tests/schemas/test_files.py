"""Files appear whole or not at all."""

import pickle
from pathlib import Path

import pytest

from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import (
    atomic,
    location,
    mapped,
    read_at,
    reading,
    remove_tree,
    unreachable,
    why,
)


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


@pytest.fixture
def memory() -> Path:
    """An empty folder behind a URL whose puts can be seen half done."""
    folder = location("memory://files")
    remove_tree(folder)
    return folder


def test_file_behind_a_url_appears_when_complete(memory: Path) -> None:
    path = memory / "deep" / "file"
    for content in (b"abc", b"another"):
        with atomic(path) as stream:
            stream.write(content)
            assert not path.exists() or path.read_bytes() != content
        assert path.read_bytes() == content
    with pytest.raises(RuntimeError), atomic(path) as stream:
        stream.write(b"half")
        raise RuntimeError
    assert path.read_bytes() == b"another" and [str(p) for p in path.parent.iterdir()] == [str(path)]


def test_both_kinds_are_read_alike(memory: Path, tmp_path: Path) -> None:
    for folder in (memory, tmp_path):
        path = folder / "sub" / "file"
        with atomic(path) as stream:
            stream.write(b"0123456789")
        assert read_at(path, 3, 4) == b"3456" and mapped(path)[:] == b"0123456789"
        with reading(path) as stream:
            stream.seek(-2, 2)
            assert stream.read() == b"89"
        assert location(str(path)) == path == pickle.loads(pickle.dumps(path))
        remove_tree(folder / "sub")
        remove_tree(folder / "sub")
        assert not path.exists()


def test_only_what_goes_between_is_a_lost_connection(memory: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        (memory / "nothing").read_bytes()
    assert why(caught.value) == "No such file" and not unreachable(caught.value)
    assert unreachable(ConnectionResetError()) and why(OSError(28, "No space left")) == "No space left"


def test_an_empty_name_is_not_the_current_folder() -> None:
    with pytest.raises(UsageError, match=r"an empty name .* current folder is \."):
        location("")
    assert location(".") == Path()
