"""What other projects copy into their continuous integration."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

FOLDER = Path(__file__).parents[2] / "examples" / "ci"


def check(*arguments: object, code: int = 0) -> str:
    command = [sys.executable, FOLDER / "check_bits.py", *arguments]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    return done.stdout


def test_simulated_scans_take_the_bits_that_are_stored() -> None:
    assert re.fullmatch(r"simulated 00: [\d.]+ bits a point, [\d.]+ expected: ok\n", check())


def test_a_figure_is_stored_and_more_bits_fail(toy_root: Path, tmp_path: Path) -> None:
    expected = tmp_path / "bits.json"
    given = ["--root", toy_root, "--sequence", "01", "--expected", expected]
    assert "store one with --store" in check(*given, code=1)
    check(*given, "--store")
    stored = json.loads(expected.read_text())
    expected.write_text(json.dumps({"recorded 01": stored["recorded 01"] / 1.05}))
    assert "MORE THAN IT WAS" in check(*given, code=1)
    assert "ok" in check(*given, "--allow", 0.06)


def test_scans_that_do_not_come_back_fail(toy_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("check_bits", FOLDER / "check_bits.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    asked: list[tuple[object, ...]] = []

    def tool(*arguments: object) -> str:
        asked.append(arguments)
        if arguments[0] == "verify":
            raise subprocess.CalledProcessError(1, "verify")
        return "{}"

    monkeypatch.setattr(module, "tool", tool)
    with pytest.raises(subprocess.CalledProcessError):
        module.measure(toy_root, "00", Path("out"))
    assert asked[-1][-2:] == ("--against", toy_root)


def test_the_workflow_runs_the_script() -> None:
    text = (FOLDER / "lidar-bits.yml").read_text()
    (job,) = yaml.safe_load(text)["jobs"].values()
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert commands == ["pip install 'salpcc-pipeline[run]'", "python ci/check_bits.py"]
    assert all(name in text for name in ("check_bits.py", "expected_bits.json"))
