"""Where Open3D does not start, one line says what is lacking."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from salpcc.schemas.errors import UsageError
from salpcc.stages.mapping import open3d_library
from salpcc.stages.mapping.open3d_library import load_open3d


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (
            ImportError("libGL.so.1: cannot open shared object file: No such file or directory"),
            r"the system lacks libGL\.so\.1; Debian, Ubuntu: apt-get install libusb-1.0-0 libgl1",
        ),
        (OSError("libX11.so.6: cannot open shared object file: no"), r"the system lacks libX11\.so\.6;"),
        (ImportError("built for another Python\nand more"), r"start, built for another Python; Debian"),
        (ModuleNotFoundError("open3d"), r"not installed: pip install 'salpcc-pipeline\[open3d\]'"),
    ],
)
def test_what_is_lacking_is_one_line(raised: Exception, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def import_(name: str) -> None:
        raise raised

    monkeypatch.setattr(open3d_library, "import_module", import_)
    with pytest.raises(UsageError, match=said) as caught:
        load_open3d()
    assert "\n" not in str(caught.value)


def test_libusb_of_the_wheel_is_loaded_first(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []

    def import_(name: str) -> object:
        told.append(name)
        return SimpleNamespace(get_library_path=lambda: "wheel/libusb-1.0.so")

    monkeypatch.setattr(open3d_library, "import_module", import_)
    monkeypatch.setattr(open3d_library.ctypes, "CDLL", told.append)
    load_open3d()
    assert told == ["libusb_package", "wheel/libusb-1.0.so", "open3d"]
