"""What a command does not need, it does not load: the compiler and the libraries behind it take seconds."""

import re
import subprocess
import sys

import pytest

from salpcc.pipeline.export import EXPORTS
from salpcc.schemas.version import TOOL
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.mapping.cleaners import CLEANERS

HEAVY = [
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "torch",
    "pyarrow",
    "dask",
    "distributed",
    "rosbags",
    "laspy",
    "matplotlib",
]
HELP = """
import sys
sys.argv = ["salpcc-pipeline", *{arguments!r}]
from salpcc.pipeline.cli.app import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
"""
LOADED = "\nprint('loaded', *sorted(name for name in sys.modules if '.' not in name))"


def loaded(code: str) -> tuple[str, set[str]]:
    """What some code prints, and the modules that are loaded afterwards."""
    done = subprocess.run(
        [sys.executable, "-c", "import sys\n" + code + LOADED], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    shown, _, names = done.stdout.rpartition("loaded ")
    return shown, set(names.split())


@pytest.mark.parametrize(
    "code",
    [
        "import salpcc; salpcc.__version__",
        "import salpcc.pipeline",
        HELP.format(arguments=["--help"]),
        HELP.format(arguments=["run", "sequences", "--help"]),
        HELP.format(arguments=["decode", "--help"]),
        HELP.format(arguments=["map", "--help"]),
    ],
)
def test_what_only_tells_loads_nothing_heavy(code: str) -> None:
    _, names = loaded(code)
    assert not names & set(HEAVY)


def test_the_doors_open_when_they_are_used() -> None:
    _, names = loaded(
        "from salpcc.pipeline import Archive, Scan, encode_scans\nimport salpcc.pipeline as p\np.Archive"
    )
    assert "numba" in names
    with pytest.raises(ImportError, match="Archives"):
        from salpcc.pipeline import Archives  # noqa: F401


def test_the_package_itself_is_the_door() -> None:
    import salpcc
    import salpcc.pipeline

    for name in salpcc.pipeline.__all__:
        assert getattr(salpcc, name) is getattr(salpcc.pipeline, name) and name in dir(salpcc)
    assert salpcc.__version__ and salpcc.__version__ in TOOL
    with pytest.raises(AttributeError, match="'salpcc' has no attribute 'Archives'"):
        _ = salpcc.Archives


@pytest.mark.parametrize(
    ("arguments", "choices"),
    [
        (["run", "sequences", "--help"], SOURCES),
        (["decode", "--help"], EXPORTS),
        (["map", "--help"], CLEANERS),
    ],
)
def test_help_names_every_choice(arguments: list[str], choices: dict[str, object]) -> None:
    """They stand in the text of the command, so that telling them loads none of them."""
    shown, _ = loaded(HELP.format(arguments=arguments))
    assert set(choices) <= set(re.findall(r"\w+", shown))


def options() -> list[tuple[str, object]]:
    """Every argument and option of every command, with its command."""
    from typer.main import get_command

    from salpcc.pipeline.cli.app import app

    found: list[tuple[str, object]] = []
    commands = [("", get_command(app))]
    while commands:
        name, command = commands.pop()
        commands += [(f"{name} {sub}", each) for sub, each in getattr(command, "commands", {}).items()]
        found += [(name, parameter) for parameter in command.params]
    return found


def test_help_is_whole_sentences() -> None:
    assert len(options()) > 80
    for command, parameter in options():
        text = str(getattr(parameter, "help", "") or "")
        where = f"{command} {getattr(parameter, 'name', '')}: {text!r}"
        assert text[:1].isupper() and text.partition(" [default")[0].rstrip()[-1:] in ".", where


def test_the_options_of_run_stand_in_four_groups() -> None:
    groups = ["Input and output", "What is kept", "Coding", "Running"]
    for command in ("sequences", "log"):
        shown, _ = loaded(HELP.format(arguments=["run", command, "--help"]))
        assert [line for line in groups if line in shown] == groups
        places = [shown.index(f"─ {group} ─") for group in groups]
        assert places == sorted(places)
        options_panel = shown[shown.index("─ Options ─") : places[0]]
        assert "--help" in options_panel and options_panel.count("--") == 1


def test_a_shell_can_complete() -> None:
    shown, names = loaded(
        "import os\nos.environ |= {'_SALPCC_PIPELINE_COMPLETE': 'complete_bash', 'COMP_CWORD': '1', "
        "'COMP_WORDS': 'salpcc-pipeline in'}\n" + HELP.format(arguments=[])
    )
    assert shown.split() == ["inspect"] and not names & set(HEAVY)
