"""What other projects copy into their continuous integration."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest
import yaml

FOLDER = Path(__file__).parents[2] / "examples" / "ci"


def test_simulated_scans_take_the_bits_that_are_stored() -> None:
    command = [sys.executable, str(FOLDER / "check_bits.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"simulated 00: [\d.]+ bits a point, [\d.]+ expected: ok\n", done.stdout)


@pytest.fixture
def script() -> ModuleType:
    """The script as a module."""
    spec = spec_from_file_location("check_bits", FOLDER / "check_bits.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_figure_is_stored_and_more_bits_fail(
    script: ModuleType,
    toy_root: Path,
    tmp_path: Path,
    cli: Callable[..., subprocess.CompletedProcess[str]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def tool(*arguments: object) -> str:
        done = cli(*arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def checked(*more: object, code: int = 0) -> str:
        given = ["--root", toy_root, "--sequence", "01", "--expected", expected, *more]
        monkeypatch.setattr("sys.argv", ["check_bits.py", *map(str, given)])
        assert script.main() == code
        return capsys.readouterr().out

    expected = tmp_path / "bits.json"
    monkeypatch.setattr(script, "tool", tool)
    assert "store one with --store" in checked(code=1)
    checked("--store")
    stored = json.loads(expected.read_text())
    expected.write_text(json.dumps({"recorded 01": stored["recorded 01"] / 1.05}))
    assert "MORE THAN IT WAS" in checked(code=1)
    assert "ok" in checked("--allow", 0.06)


def test_scans_that_do_not_come_back_fail(
    script: ModuleType, toy_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, ...]] = []

    def tool(*arguments: object) -> str:
        asked.append(arguments)
        if arguments[0] == "verify":
            raise subprocess.CalledProcessError(1, "verify")
        return "{}"

    monkeypatch.setattr(script, "tool", tool)
    with pytest.raises(subprocess.CalledProcessError):
        script.measure(toy_root, "00", Path("out"))
    assert asked[-1][-2:] == ("--against", toy_root)


def test_the_workflow_runs_the_script() -> None:
    text = (FOLDER / "lidar-bits.yml").read_text()
    (job,) = yaml.safe_load(text)["jobs"].values()
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert commands == ["pip install 'salpcc-pipeline[run]'", "python ci/check_bits.py"]
    assert all(name in text for name in ("check_bits.py", "expected_bits.json"))
