"""Options of a scene on the command line are those that its parts declare."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from orograph.cli import movie, render, view
from orograph.cli.scenes import DETAILS, SCENE, _option, check_scene, given_of
from orograph.cli.view import NOT_HERE
from orograph.errors import UsageError
from orograph.lod.options import described, option
from orograph.progress import SILENT
from orograph.scene.contours import Contours
from orograph.scene.parts import OPTIONS, PARTS
from orograph.scene.silhouettes import Silhouettes


def params(command: click.Command) -> dict[str, click.Parameter]:
    return {str(one.name): one for one in command.params}


def test_verbs_have_every_option_once_with_its_help() -> None:
    whole = [len(described(kind)) for kind in PARTS.values()]
    assert sum(whole) == len(OPTIONS)
    for command, without in ((render.command, ()), (movie.command, ()), (view.command, NOT_HERE)):
        given = params(command)
        flags = [flag for one in command.params for flag in one.opts]
        assert len(flags) == len(set(flags))
        for name, one in SCENE.items():
            assert (name in given) == (name not in without), name
            if name not in without:
                assert f"--{one.key}" in given[name].opts
        for more in DETAILS.values():
            assert set(more) - set(without) <= set(given)
    assert "--light-at" in params(render.command)["lamps"].opts
    assert OPTIONS["depths"].flag is None and "depths" not in SCENE


def test_a_field_alone_makes_an_option() -> None:
    import dataclasses

    @dataclasses.dataclass
    class Part:
        haze: float = option(0.5, "How much haze there is, with `sky`.", least=0, most=1, metavar="X")
        grain: bool = option(True, "Whether paper has a grain.")
        paper: str | None = option(None, "Of what.", shown="wove", flag="made-of")
        tone: str = option("warm", "Of the paper.", choices=("warm", "cold"))

    @click.command()
    def verb(**given: object) -> None:
        click.echo(repr(given))

    for one in reversed(described(Part)):
        verb = _option(one)(verb)
    told = " ".join(CliRunner().invoke(verb, ["--help"]).output.split())
    for words in ("--haze X How much haze there is, with --sky. [default: 0.5; 0<=x<=1]", "--grain / --no-grain",
                  "--made-of TEXT Of what. [default: wove]", "--tone [warm|cold]"):  # fmt: skip
        assert words in told, words
    ran = CliRunner().invoke(verb, ["--haze", "0.25", "--no-grain", "--made-of", "linen"])
    assert ran.output == "{'haze': 0.25, 'grain': False, 'paper': 'linen', 'tone': 'warm'}\n"
    assert CliRunner().invoke(verb, ["--haze", "2"]).exit_code == 2


def defaults(*words: str) -> dict[str, object]:
    context = render.command.make_context("render", ["dem.tif", "-o", "a.png", *words])
    return context.params


def test_what_is_not_said_is_left_to_the_parts() -> None:
    given = given_of(defaults())
    assert {name for name, value in given.items() if value != OPTIONS[name].default} == set()
    assert not {"sun", "tolerance", "lamps", "contours"} & set(given)


def test_details_go_into_the_value_they_are_of() -> None:
    given = given_of(defaults("--contours", "25", "--contour-index", "4", "--no-contour-labels", "--silhouettes"))
    assert given["contours"] == Contours(25.0, 4, labels=False)
    assert given["silhouettes"] == Silhouettes()
    assert given_of(defaults("--contours", "auto"))["contours"] == Contours()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--wireframe"], "`wireframe` applies to the mesh"),
        (["--method", "soar", "--triangles", "9", "--tolerance", "1"], "`tolerance` or `triangles`"),
        (["--light-at", "1,2,3,4"], "does not support `lamps`"),
        (["--disc", "1,2,3", "--light", "ao"], "does not support `discs`"),
    ],
)
def test_contradictions_are_found_before_there_is_a_terrain(words: list[str], said: str) -> None:
    with pytest.raises(UsageError) as error:
        check_scene(defaults(*words), SILENT)
    assert said in str(error.value)
