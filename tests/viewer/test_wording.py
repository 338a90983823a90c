"""What the library says in Python's names, the window says in its own."""

from __future__ import annotations

import importlib
import re

import pytest

from orograph.cli.wording import flags_of
from orograph.viewer.session import Messages
from orograph.viewer.wording import STARTED, spoken


@pytest.mark.parametrize(
    ("python", "words"),
    [
        ("Give `tolerance` or `triangles`.", "Give tolerance or triangles."),
        ('It needs `light="raytraced"`, or `shadows=False`.', "It needs light raytraced, or no cast shadows."),
        ("Not into the 64 MiB for it (`max_memory`).", "Not into the 64 MiB for it (--memory)."),
        ("Bake it (`orograph.bake('a.oro', ['openness'])`).", "Bake it (orograph bake a.oro --products openness)."),
        ("Build it with `spacing=30`.", "Build it with spacing 30."),
        ("nothing", "nothing"),
    ],
)
def test_python_in_the_windows_words(python, words):
    assert spoken(python) == words


def test_options_of_the_start_are_called_as_view_calls_them():
    flags = flags_of(importlib.import_module("orograph.cli.view").command)
    assert {name: flags[name] for name in STARTED} == STARTED


def test_no_message_has_backticks():
    messages = Messages()
    messages.say("The store has no layer. Put it in: `orograph.bake(store, ['ao'])`.", error=True)
    messages.say("`tolerance` is too small.")
    assert [m.text for m in messages.shown] == [
        "The store has no layer. Put it in: orograph bake STORE --products ao.", "tolerance is too small.",
    ]  # fmt: skip
    messages.drop("`tolerance`")
    assert not [m for m in messages.shown if re.search("tolerance", m.text)]
