"""The command line. Only here anything is printed and exit codes are chosen: 0 done, 1 failed, 2 wrong use, 130 interrupted."""

from __future__ import annotations

import errno
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from salpcc.pipeline.cli import archives as cli_archive
from salpcc.pipeline.cli import data as cli_data
from salpcc.pipeline.cli import maps as cli_map
from salpcc.pipeline.cli import parts as cli_parts
from salpcc.pipeline.cli import run_log as cli_log
from salpcc.pipeline.cli import run_sequences as cli_run
from salpcc.pipeline.cli import train_networks as cli_train
from salpcc.pipeline.schedule.machine import allowed_mb
from salpcc.pipeline.schedule.progress import STDERR
from salpcc.schemas.errors import DamagedError, LogWarning, SalpccError, UsageError
from salpcc.schemas.files import unreachable, why
from salpcc.stages.memory import keep_memory

_INTERRUPTED = 130  # typer's exit code for Ctrl-C
# A file or folder that cannot be what it was named for is wrong use; a disk that fails is not.
_WRONG_PLACE = (
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.EEXIST,
    errno.ENAMETOOLONG,
)
# Libraries and kernels take 700 on two cores. With less the OpenBLAS of one may look for memory for ever.
_LEAST_MB = 1000
_ON_THIS_MACHINE = ("calibrate", "localise", "map", "simulate", "train")  # others take URLs


class _MainFirst(TyperGroup):
    """Lists ``run`` before what is done with its archives."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands in the order of the help."""
        return sorted(super().list_commands(ctx), key=lambda name: name != "run")


app = typer.Typer(
    name="salpcc-pipeline",
    cls=_MainFirst,
    help="Recorded LiDAR scans in, compact bit-exact archives and a report out; and back again.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
cli_log.register(cli_run.app)
app.add_typer(cli_run.app, name="run")
app.add_typer(cli_train.app, name="train")
cli_archive.register(app)
cli_parts.register(app)
cli_map.register(app)
cli_data.register(app)


def _version(wanted: bool) -> None:
    if wanted:
        from salpcc.schemas.version import TOOL

        typer.echo(TOOL)
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Recorded LiDAR scans in, compact bit-exact archives and a report out; and back again."""
    if (most := allowed_mb()) < _LEAST_MB:
        raise SalpccError(
            f"no more than {most:.0f} MB of memory may be asked for here (ulimit -v), and the libraries need "
            f"{_LEAST_MB} of these; raise the limit"
        )
    for argument in sys.argv if context.invoked_subcommand in _ON_THIS_MACHINE else ():
        if "://" in argument and not argument.startswith(("tcp:", "tls:")):
            raise UsageError(f"{context.invoked_subcommand} works in folders; copy {argument} to one first")


def main() -> None:
    """Run the command line (entry point of ``salpcc-pipeline``)."""
    keep_memory()
    try:
        with _notes():
            app()
    except UsageError as error:
        _fail(str(error), 2)
    except DamagedError as error:
        _fail(f"{error}; `salpcc-pipeline recover` saves what is whole", 1)
    except SalpccError as error:
        _fail(str(error), 1)
    except MemoryError:
        _fail("out of memory; more of it, or fewer --threads or --workers where there are such, may do", 1)
    except Exception as error:
        if unreachable(error):
            _fail(f"{why(error)}; check the address, and the credentials in the environment", 1)
        if not isinstance(error, OSError):
            raise
        where = f"{error.filename}: " if error.filename else ""
        wrong_place = error.errno in _WRONG_PLACE
        _fail(f"{where}{why(error)}{'; name another place' if wrong_place else ''}", 2 if wrong_place else 1)
    except SystemExit as end:
        if end.code == _INTERRUPTED:
            _fail("interrupted; the same command goes on where it stopped", _INTERRUPTED)
        raise


@contextmanager
def _notes() -> Iterator[None]:
    """Print what is to be said of a log as a line each."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", LogWarning)
        shown = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, LogWarning):
                STDERR.print(f"note: {message}", soft_wrap=True)
            else:
                shown(message, category, *where, **more)

        warnings.showwarning = show
        yield


def _fail(line: str, code: int) -> None:
    STDERR.print(f"error: {line}", soft_wrap=True, style="red")
    sys.exit(code)
