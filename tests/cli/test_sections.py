"""Help in sections."""

import re

import click
import pytest

from orograph.cli import VERBS, cli
from orograph.cli.sections import SECTION, TITLES


def verbs(group=cli, names=tuple(VERBS)):
    for name in names:
        command = group.get_command(click.Context(group), name)
        yield from verbs(command, tuple(command.commands)) if isinstance(command, click.Group) else [command]


@pytest.mark.parametrize("verb", list(verbs()), ids=lambda verb: verb.name)
def test_every_option_stands_in_help_once(verb):
    said = verb.get_help(click.Context(verb, info_name=verb.name))
    said = said[said.index("\nOptions:") :]
    for param in verb.params:
        if isinstance(param, click.Option) and not param.hidden:
            flag = re.compile(rf"^  (?:-\w, )?{max(param.opts, key=len)}(?![\w-])", re.MULTILINE)
            assert len(flag.findall(said)) == 1, flag
    heads = [line[:-1] for line in said.splitlines() if line[:-1] in TITLES]
    assert heads == [title for title in TITLES if title in heads] and "Options" in heads


def test_sections_name_options_that_are_there():
    there = {param.name for verb in verbs() for param in verb.params}
    assert set(SECTION) - there <= {"depths"}  # (which Python alone has)


def test_arguments_are_not_among_the_options(run):
    for verb in (("render",), ("info",), ("measure", "slope")):
        _, said, _ = run(*verb, "--help")
        assert not [line for line in said.splitlines() if line.strip() in ("PATH", "PATH...", "POINT")]
