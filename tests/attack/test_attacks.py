"""Verbs that are killed, interrupted, out of room or started together, and odd values of options: see ``attacks``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.stress,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and mounts small disks"),
]

HERE = Path(__file__).parent


def run(script: str, *args: object) -> str:
    ran = subprocess.run([sys.executable, HERE / script, *map(str, args)], capture_output=True, text=True, timeout=3000)
    assert ran.returncode == 0, ran.stdout[-6000:] + ran.stderr[-2000:]
    return ran.stdout


@pytest.mark.parametrize("kind", ["kills", "signals", "limits", "races", "room"])
def test_nothing_is_lost_whatever_ends_a_verb(shared_data, tmp_path, kind, request):
    pytest.importorskip("moto.server")
    if kind == "room":
        request.getfixturevalue("small_disk")(64)
    assert "0 broken" in run("attacked.py", tmp_path / "a", 2, 7, kind)


def test_odd_values_are_refused_in_words(shared_data, tmp_path):
    run("odd_values.py", tmp_path / "a", 300, 7)
