"""Caches of compiled kernels, from one version of a source to the next."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = """
from typing import NamedTuple
from orograph._numba import kernel

class NAME(NamedTuple):
    value: float

@kernel
def doubled(given):
    return 2.0 * given.value

print(doubled(NAME(21.0)))
"""


def test_an_argument_may_have_another_type_in_the_next_version(tmp_path: Path) -> None:
    """The cache's index still names the class that there was: nobody should have to remove it."""
    for name in ("Before", "After"):
        (tmp_path / "kernels.py").write_text(SOURCE.replace("NAME", name))
        done = subprocess.run([sys.executable, "-c", "import kernels"], cwd=tmp_path, capture_output=True, text=True)
        assert done.stdout == "42.0\n", done.stderr
    assert list(tmp_path.glob("__pycache__/*.nbi"))


def test_a_full_disk_keeps_no_kernel_and_stops_none(tmp_path: Path) -> None:
    pytest.importorskip("resource")
    (tmp_path / "kernels.py").write_text(SOURCE.replace("NAME", "Given"))
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); import kernels"
    done = subprocess.run([sys.executable, "-c", full], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "42.0\n", done.stderr
