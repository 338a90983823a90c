"""The page of the first hour: each task runs, in the shell and in Python, on the sample, as it is written."""

from __future__ import annotations

import re
import shlex
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from orograph.cli import cli
from orograph.sample import write_jacksboro

PAGE = Path(__file__).parents[1] / "docs/tasks.md"
TASKS = PAGE.read_text(encoding="utf-8").split("\n## ")[1:]


def test_there_are_ten() -> None:
    assert len(TASKS) == 10


@pytest.mark.stress
def test_they_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    write_jacksboro(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}  # one session, as a reader has it
    for task in TASKS:
        shell, python = (re.findall(rf"^```{kind}\n(.*?)^```", task, re.M | re.S) for kind in ("sh", "python"))
        assert shell and python
        for line in "".join(shell).splitlines():
            in_shell(line)
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            exec(compile("".join(python), f"{PAGE.name}: {task.splitlines()[0]}", "exec"), names)


def in_shell(line: str) -> None:
    program, *arguments = shlex.split(line)
    assert program == "orograph"
    ran = CliRunner().invoke(cli, ["-q", *arguments], obj={}, catch_exceptions=False)
    assert ran.exit_code == 0, (line, ran.output)
    for option, name in pairwise(arguments):
        if option in ("-o", "--picture"):
            assert Path(name).exists(), line
