"""What is on disk is what is installed, and what an editor finds."""

import ast
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from setuptools import find_namespace_packages

ROOT = Path(__file__).parents[1]
ROOMS = ("schemas", "stages", "pipeline")
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_links_lead_to_the_folders_of_the_top_level() -> None:
    """What an editor reads, what is installed and what stands at the top are the same files."""
    for room in ROOMS:
        assert (ROOT / "src" / "salpcc" / room).resolve() == ROOT / room


def test_an_editor_resolves_every_name_of_ours() -> None:
    """Every ``salpcc`` module that is imported anywhere is a file below ``src``."""
    for path in (
        file for folder in (*ROOMS, "tests", "examples", "scripts") for file in (ROOT / folder).rglob("*.py")
    ):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in (name for name in names if name.startswith("salpcc.")):
                place = ROOT.joinpath("src", *name.split("."))
                assert place.with_suffix(".py").is_file() or place.is_dir(), f"{path}: {name}"


def test_every_folder_of_modules_is_a_package() -> None:
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), f"{path.parent} holds modules but no __init__.py"


def test_every_data_file_is_installed() -> None:
    installed: set[Path] = set()
    for package in find_namespace_packages(str(ROOT / "src")):
        folder = ROOT.joinpath(*package.split(".")[1:])
        for owner in ("*", package):
            for pattern in SETUP["tool"]["setuptools"]["package-data"].get(owner, []):
                installed |= set(folder.glob(pattern))
    for room in ROOMS:
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
    own = {project["name"]}  # extras that take others in
    assert {normal(name) for name in wanted} - own <= {normal(line) for line in lines}
    loose = [line for line in lines if "==" not in line.split(";")[0]]
    assert all(line.startswith("open3d>=") for line in loose), loose  # only where no pin can be tested
