"""The wheel alone, with what it names as the core and nothing else, reads, writes and verifies archives."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from salpcc.schemas.extras import EXTRAS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HEAVY = {
    "bokeh", "brotli", "dask", "distributed", "fsspec", "jinja2", "laspy", "matplotlib", "mfusepy", "open3d", "plyfile",
    "pyproj", "safetensors", "scipy", "small_gicp", "torch",
}  # fmt: skip
MOST_PACKAGES = 25
ENCODE = """
import numpy as np
from salpcc import Archive, Scan, encode_scans
points = np.random.default_rng(0).normal(0, 9, (500, 3)).astype(np.float32)
path = encode_scans([Scan("000000", points, points[:, 0])], {path!r}, effort="fast")
with Archive(path) as archive:
    assert (archive[0].points == points).all()
print("same")
"""


def wheel_of(folder: Path) -> Path:
    """Build the wheel from a copy of the sources, so that no build folder is left in them."""
    source = folder / "source"
    shutil.copytree(
        ROOT,
        source,
        symlinks=True,
        ignore=shutil.ignore_patterns(".*", "build", "out", "tests", "__pycache__", "*.egg-info"),
    )
    command = ["-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]
    subprocess.run(
        [sys.executable, *command, "--wheel-dir", str(folder), str(source)],
        check=True,
        capture_output=True,
        text=True,
    )
    return next(folder.glob("*.whl"))


def core() -> dict[str, Distribution]:
    """The installed packages that the core names, and those that they name, by their names."""
    found: dict[str, Distribution] = {}
    wanted = [Requirement(line) for line in PROJECT["dependencies"]]
    while wanted:
        requirement = wanted.pop()
        name = requirement.name.lower().replace("_", "-")
        if name in found or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        try:
            found[name] = distribution(requirement.name)
        except PackageNotFoundError:
            pytest.skip(f"{requirement.name} is not installed here")
        wanted += [Requirement(line) for line in found[name].requires or ()]
    return found


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of a new environment that holds the wheel, and links to the core's packages of this one."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder / "env", with_pip=False)
    python = folder / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(
        subprocess.run([python, "-c", ask], check=True, capture_output=True, text=True).stdout[:-1]
    )
    for package in core().values():
        for top in {Path(file).parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(Path(str(package.locate_file(top))))
    with ZipFile(wheel_of(folder)) as wheel:
        wheel.extractall(packages)
    return python


def run(python: Path, *arguments: object, code: int = 0) -> str:
    """What a process of the new environment prints; only that, the environment and a folder of its own are there."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [python, "-I", *map(str, arguments)],
        capture_output=True, text=True, check=False, timeout=900, env=environment, cwd=python.parent,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


def cli(python: Path, *arguments: object, code: int = 0) -> str:
    return run(python, "-m", "salpcc.pipeline.cli", *arguments, code=code)


def test_the_core_is_small() -> None:
    names = set(core())
    assert len(names) <= MOST_PACKAGES, sorted(names)
    assert not names & HEAVY


def test_the_wheel_alone_reads_verifies_and_writes(bare: Path, tmp_path: Path) -> None:
    find = f"from importlib.util import find_spec; print([n for n in {sorted(HEAVY)} if find_spec(n)])"
    assert run(bare, "-c", find) == "[]\n"
    version = run(bare, "-c", "import salpcc; print(salpcc.__version__, salpcc.__file__)").split()
    assert version[0] == PROJECT["version"] and str(bare.parents[1]) in version[1]

    archive = ROOT / "tests" / "golden" / "fast_exact.mcap"
    verdict = json.loads(cli(bare, "verify", archive, "--json"))
    assert verdict["good"] and verdict["points"] > 0
    cli(bare, "decode", archive, "--to", "kitti", "--out", tmp_path)
    assert sum(path.stat().st_size for path in tmp_path.rglob("*.bin")) == 16 * verdict["points"]
    log = ROOT / "tests" / "golden" / "log" / "log.mcap"
    assert json.loads(cli(bare, "verify", log, "--json"))["good"]
    assert "sensor" in cli(bare, "inspect", archive)
    assert run(bare, "-c", ENCODE.format(path=str(tmp_path / "new.mcap"))) == "same\n"


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("run sequences 00 --source simulated", "run"),
        ("run log LOG", "run"),
        ("simulate --out new", "run"),
        ("report OUT", "run"),
        ("map ARCHIVE --out new", "map"),
        ("localise ARCHIVE --against . --out new", "map"),
        ("decode ARCHIVE --to laz --out new", "map"),
        ("decode ARCHIVE --to ply --out new", "map"),
        ("mount ARCHIVE new", "files"),
        ("view ARCHIVE", "view"),
        ("inspect s3://bucket/00.mcap", "s3"),
        ("verify PAPER", "paper"),
        ("train segment --data .", "segment"),
        ("train predict --data .", "paper"),
        ("train coder --data .", "segment"),
    ],
)
def test_a_missing_extra_is_one_line_that_names_it(
    bare: Path, tmp_path: Path, command: str, extra: str
) -> None:
    golden = ROOT / "tests" / "golden"
    (tmp_path / "out" / "report").mkdir(parents=True)
    places = {
        "ARCHIVE": golden / "fast_exact.mcap",
        "LOG": golden / "log" / "log.mcap",
        "PAPER": golden / "nets" / "paper_ppmd.mcap",
        "OUT": tmp_path / "out",
        "new": tmp_path / "new",
        ".": tmp_path,
    }
    said = cli(bare, *(places.get(word, word) for word in command.split()), code=2)
    assert said.count("\n") == 1 and f"pip install 'salpcc-pipeline[{extra}]'" in said
    assert not (tmp_path / "new").exists()


def test_leaving_out_what_moves_names_its_extra(bare: Path, tmp_path: Path) -> None:
    code = ENCODE.format(path=str(tmp_path / "new.mcap")).replace('"fast"', '"fast", keep_movable=False')
    said = run(bare, "-c", code, code=1)
    assert said.splitlines()[-1].endswith("pip install 'salpcc-pipeline[segment]'")


def packages_of(extra: str) -> Iterator[Requirement]:
    """What an extra names, and what extras that it names do."""
    for requirement in map(Requirement, PROJECT["optional-dependencies"][extra]):
        if requirement.name == PROJECT["name"]:
            for other in requirement.extras:
                yield from packages_of(other)
        else:
            yield requirement


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_brings_what_is_asked_for(extra: str) -> None:
    packages = {requirement.name.lower().replace("-", "_") for requirement in packages_of(extra)}
    told = {"upath": "universal_pathlib", "rerun": "rerun_sdk"}
    modules = {told.get(name, name) for name in EXTRAS[extra]}
    assert modules <= packages


def test_all_is_all_that_needs_nothing_of_the_system() -> None:
    every = set(PROJECT["optional-dependencies"]) - {"all", "dev", "open3d"}
    assert {str(r) for r in packages_of("all")} == {str(r) for extra in every for r in packages_of(extra)}


@pytest.mark.parametrize("extra", ["segment", "paper"])
def test_torch_of_other_versions_will_do(extra: str) -> None:
    """Only the lock file pins it: users have one already, for their GPU."""
    ranges: SpecifierSet = next(r.specifier for r in packages_of(extra) if r.name == "torch")
    assert all(version in ranges for version in ("2.4.1", "2.13.0", "2.14.1", "2.13.0+cu126"))
    assert not any(one.operator in ("==", "===", "<", "<=") for one in ranges)
    assert "torch==" in (ROOT / "requirements.lock").read_text()


def test_python_311_to_313() -> None:
    assert "3.11" in SpecifierSet(PROJECT["requires-python"])
    told = {line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python ::" in line}
    assert told == {"3.11", "3.12", "3.13"}
