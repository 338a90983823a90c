"""Threads beside a loop that must not wait."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys, time
from orograph.gpu.background import BackgroundTask

def make():
    time.sleep(0.3)
    open(sys.argv[1], "w").write("done")

BackgroundTask().start("key", make)
"""


def test_an_ending_program_waits_for_what_is_under_way(tmp_path: Path) -> None:
    """A thread in a native library that the interpreter leaves behind crashes."""
    written = tmp_path / "written"
    subprocess.run([sys.executable, "-c", SCRIPT, str(written)], check=True, timeout=60)
    assert written.read_text() == "done"
