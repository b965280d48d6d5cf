"""What is installed beside the core: extras of the package, and one line for those that are missing."""

from __future__ import annotations

from importlib.util import find_spec

from salpcc.schemas.errors import UsageError

# By extra, the modules without which nothing of it works. pyproject.toml has the packages.
EXTRAS = {
    "run": ("bokeh", "dask", "distributed", "jinja2", "matplotlib", "scipy"),
    "segment": ("safetensors", "scipy", "torch"),
    "paper": ("brotli", "inflate64", "pyppmd", "safetensors", "scipy", "torch"),
    "map": ("dask", "distributed", "laspy", "lazrs", "matplotlib", "plyfile", "scipy", "small_gicp"),
    "view": ("rerun",),
    "files": ("fsspec", "mfusepy"),
    "s3": ("fsspec", "upath"),
}


def require(extra: str, what: str) -> None:
    """Refuse to go on where an extra is not installed, before anything is done in vain.

    Args:
        extra: a key of :data:`EXTRAS`.
        what: that needs it, as the user calls it.

    Raises:
        UsageError: a module of it cannot be found; the line names the extra.
    """
    lacking = [name for name in EXTRAS[extra] if find_spec(name) is None]
    if lacking:
        raise UsageError(
            f"{what} needs {', '.join(lacking)}, which {'is' if len(lacking) == 1 else 'are'} not installed: "
            f"pip install 'salpcc-pipeline[{extra}]'"
        )
