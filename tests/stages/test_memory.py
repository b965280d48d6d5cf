"""Freed memory stays with the process: pages that are used again are not asked of the system again."""

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from salpcc.stages.memory import keep_memory

if sys.argv[1:]:
    keep_memory()
for _ in range(21):
    arrays = [np.ones(1 << 20) for _ in range(4)]  # 8 MB each
    del arrays
    first = resource.getrusage(resource.RUSAGE_SELF).ru_minflt if _ == 0 else first
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - first)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other C libraries keep memory as they like")
def test_pages_are_used_again() -> None:
    kept, asked = (
        int(subprocess.run([sys.executable, "-c", FAULTS, *how], check=True, capture_output=True).stdout)
        for how in (["keep"], [])
    )
    assert kept < 2000 < asked
