"""A machine with nothing but Python will do: no library of the system is mapped but the C and C++ runtime."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import walk_packages

import pytest

ROOT = Path(__file__).parents[1]
MAPS = Path("/proc/self/maps")
# Of glibc, GCC and zlib, as libc.so.6 or libc-2.36.so.
RUNTIME = re.compile(
    r"(ld|ld-linux[\w-]*|libc|libdl|libm|libmvec|libpthread|librt|libutil|libgcc_s|libstdc\+\+|libz)(-[\d.]+)?\.so[\d.]*"
)
# Modules of Python itself, which is there: what they map belongs to it (libssl, libffi, libsqlite3).
PYTHONS_OWN = ("bz2", "ctypes", "curses", "hashlib", "lzma", "readline", "sqlite3", "ssl", "uuid", "zlib")


def mapped() -> set[str]:
    """Paths of the programs and libraries that this process has mapped."""
    rows = (line.split(maxsplit=5) for line in MAPS.read_text().splitlines())
    return {row[5] for row in rows if len(row) == 6 and "x" in row[1] and row[5].startswith("/")}


def strangers(paths: Iterable[str], own: set[str]) -> list[str]:
    """Those of the system: outside Python and its packages, and not of the runtime."""
    homes = {Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    homes |= {home.resolve() for home in homes}
    return [
        path
        for path in sorted(set(paths) - own)
        if not homes & set(Path(path).parents) and not RUNTIME.fullmatch(Path(path).name)
    ]


def named_modules() -> Iterator[str]:
    """Modules of other people that any file of ours imports, at its head or later."""
    for folder in ("schemas", "stages", "pipeline", "tests", "scripts", "examples"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    yield from (alias.name for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    yield node.module


def use_all(out: str) -> None:
    """Import all that we and our tests import, and do what ``make demo`` does, with the network besides.

    Open3D is not among it: :mod:`~salpcc.stages.mapping.open3d_library` alone imports it, and tests that need it
    skip where it does not start.
    """
    for name in sorted(set(named_modules())):
        top = name.partition(".")[0]
        if top != "salpcc" and find_spec(top) is not None:
            import_module(name)
    for room in ("schemas", "stages", "pipeline"):
        for module in walk_packages(import_module(f"salpcc.{room}").__path__, f"salpcc.{room}."):
            import_module(module.name)
    run = f"run sequences 00 --source simulated --frames 0:2 --workers 0 --out {out}"
    verify = f"verify {out}/archives/00.mcap --against {out}/simulated"
    main = import_module("salpcc.pipeline.cli").main
    for command in (run, verify):
        sys.argv[1:] = command.split()
        try:
            main()
        except SystemExit as end:
            assert not end.code, command


def mapped_by(*arguments: str) -> set[str]:
    """What is mapped at the end of a process of its own."""
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.skipif(not MAPS.exists(), reason="what is mapped can be read on Linux only")
def test_only_the_runtime_of_the_system_is_mapped(tmp_path: Path) -> None:
    paths = mapped_by(str(tmp_path))
    assert (tmp_path / "archives" / "00.mcap").exists() and any("embree" in path for path in paths)
    assert strangers(paths, mapped_by()) == []


def test_a_library_of_the_system_is_a_stranger() -> None:
    system = "/usr/lib/x86_64-linux-gnu"
    runtime = ["ld-linux-x86-64.so.2", "libc.so.6", "libm-2.31.so", "libstdc++.so.6.0.30", "libz.so.1.2.13"]
    there = [f"{system}/{name}" for name in runtime] + [f"{sysconfig.get_path('platlib')}/n.libs/libGL.so.1"]
    found = [f"{system}/{name}" for name in ("libGL.so.1.7.0", "libcrypt.so.1", "libusb-1.0.so.0")]
    assert strangers([*there, *found], set()) == found


if __name__ == "__main__":
    for own_module in PYTHONS_OWN:
        with suppress(ImportError):  # not every Python is built with all of them
            import_module(own_module)
    for folder in sys.argv[1:]:
        use_all(folder)
    print(json.dumps(sorted(mapped())))
