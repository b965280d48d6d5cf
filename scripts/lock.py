"""Print a lock file from what is installed in an environment: ``python scripts/lock.py ENVIRONMENT``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HEAD = """\
# What `make` installs, pinned: the product, its baselines, its tools. Made by `make lock`; pip only."""
# Packages that are not for every platform or Python.
MARKERS = {
    "embreex": 'sys_platform != "linux" or platform_machine == "x86_64"',
    "open3d-cpu": 'sys_platform == "linux" and platform_machine == "x86_64"',
    "backports.zstd": 'python_version < "3.14"',
}
EXTRA = 'open3d>=0.19 ; sys_platform != "linux" or platform_machine != "x86_64"'


def main(environment: Path) -> None:
    """Print the pinned packages of ``environment``, ours left out."""
    pip = [str(environment / "bin" / "pip"), "freeze", "--exclude", "salpcc-pipeline"]
    frozen = subprocess.run(pip, capture_output=True, text=True, check=True).stdout.split("\n")
    lines = []
    for line in filter(None, frozen):
        line = line.split("+")[0]  # torch's build for this machine; the pin takes any
        marker = MARKERS.get(line.split("==")[0])
        lines.append(f"{line} ; {marker}" if marker else line)
    print(HEAD, *sorted([*lines, EXTRA], key=str.lower), sep="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
