"""Import Open3D, which wants libraries of the system that slim machines lack; so nothing else here needs it."""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress
from importlib import import_module
from typing import Any

from salpcc.schemas.errors import UsageError

# Debian's and Ubuntu's names of what it is linked to.
_PACKAGES = "libusb-1.0-0 libgl1 libegl1 libx11-6 libudev1 libidn2-0"


def load_open3d() -> Any:
    """Return the module ``open3d``; the first time takes seconds.

    Raises:
        UsageError: it is not installed, or the system lacks a library that it is linked to.
    """
    # libusb is in a wheel; once it is loaded, the linker takes it for the one that it would seek in the system.
    with suppress(ImportError, OSError):
        ctypes.CDLL(str(import_module("libusb_package").get_library_path()))
    try:
        return import_module("open3d")
    except ModuleNotFoundError as error:
        raise UsageError("Open3D is not installed: pip install 'salpcc-pipeline[open3d]'") from error
    except (ImportError, OSError) as error:
        lacking = re.match(r"(lib\S+): cannot open shared object file", str(error))
        what = f"the system lacks {lacking[1]}" if lacking else str(error).partition("\n")[0]
        raise UsageError(
            f"Open3D does not start, {what}; Debian, Ubuntu: apt-get install {_PACKAGES}"
        ) from error
