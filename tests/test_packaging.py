"""What is on disk is what is installed: an unlisted subpackage would vanish from the wheel without a word."""

import tomllib
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_package_list_is_what_is_on_disk() -> None:
    found = {
        "salpcc." + str(path.parent.relative_to(ROOT)).replace("/", ".")
        for room in ("schemas", "stages", "pipeline")
        for path in (ROOT / room).rglob("__init__.py")
    }
    assert set(SETUP["tool"]["setuptools"]["packages"]) == found


def test_every_folder_of_modules_is_a_package() -> None:
    for room in ("schemas", "stages", "pipeline"):
        for path in (ROOT / room).rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), f"{path.parent} holds modules but no __init__.py"


def test_every_data_file_is_installed() -> None:
    tool = SETUP["tool"]["setuptools"]
    installed: set[Path] = set()
    for package in tool["packages"]:
        folder = ROOT.joinpath(*package.split(".")[1:])
        for owner in ("*", package):
            for pattern in tool["package-data"].get(owner, []):
                installed |= set(folder.glob(pattern))
    for room in ("schemas", "stages", "pipeline"):
        for path in (ROOT / room).rglob("*"):
            if path.is_file() and path.suffix not in (".py", ".pyc", ".nbi", ".nbc"):
                assert path in installed, f"{path} would not be installed"


@pytest.mark.parametrize("lock", ["requirements.lock"])
def test_lock_pins_every_dependency(lock: str) -> None:
    def normal(line: str) -> str:
        for end in "<>=!;[ ":
            line = line.split(end)[0]
        return line.strip().lower().replace("_", "-").replace(".", "-")

    project = SETUP["project"]
    wanted = [*project["dependencies"], *chain.from_iterable(project["optional-dependencies"].values())]
    lines = [line for line in (ROOT / lock).read_text().splitlines() if line and not line.startswith("#")]
    assert {normal(name) for name in wanted} <= {normal(line) for line in lines}
    loose = [line for line in lines if "==" not in line.split(";")[0]]
    assert all(line.startswith("open3d>=") for line in loose), loose  # only where no pin can be tested
