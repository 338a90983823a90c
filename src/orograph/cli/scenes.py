"""What is drawn, on the command line: the options of all verbs that draw, made from the fields of ``scene.parts``.

``@scene_options()`` gives a verb a keyword argument for every option of a scene that has a flag, and ``crs``,
``resolution``, ``conservative`` and ``backend``; ``scene_option`` gives one of them. ``check_scene`` refuses
contradictions before any work is done; ``given_of`` and ``scene_of`` make a scene's options, and the scene of a view.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import F, Float, FloatRange, ParamType, grid_options, with_options
from orograph.cli.refining import choice_of, conservative_option, error_kinds
from orograph.cli.wording import spoken
from orograph.lod.options import Described, described
from orograph.scene.parts import HOMES, OPTIONS, check_options

if TYPE_CHECKING:
    from orograph.error import ErrorKind
    from orograph.progress import Progress
    from orograph.scene.scene import Scene
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

SCENE = {name: one for name, one in OPTIONS.items() if one.flag is not None and HOMES[name] != "budget"}
"""The options that verbs take; those of the budget are the general ones (``cli.options``)."""

DETAILS = {
    name: {one.key.replace("-", "_"): one for one in described(whole.details) if one.flag}
    for name, whole in SCENE.items()
    if whole.details is not None
}
"""Options that belong to another option's value, by the name of the argument."""

DRAWING = {*SCENE, *(name for more in DETAILS.values() for name in more), "backend", "conservative"}
"""All options that are not about reading."""


class Text(ParamType):
    """Convert a text with an option's ``read``."""

    def __init__(self, one: Described) -> None:
        self.one, self.name = one, one.metavar or one.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str) or self.one.read is None:
            return value
        try:
            return self.one.read(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


def scene_option(name: str, **changes: Any) -> Callable[[F], F]:
    """An option of a scene; ``changes``: overrides of its description (``lod.options.Described``)."""
    return _option(replace(OPTIONS[name], **changes))


class DataOption(click.Option):
    """``--data``; each takes the ``--uncertainty`` that follows it."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        super().add_to_parser(parser, ctx)
        listened = parser._long_opt[self.opts[0]]
        took = listened.process

        def process(value: str, state: Any) -> None:
            ctx.meta.setdefault(ORDER, []).append((self.name, value))
            took(value, state)

        listened.process = process

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        pairs = self._pairs(ctx)
        if self.name == "uncertainty":
            return None
        from orograph.geovis.data.dataset import Uncertainty

        made = []
        for text, doubt in pairs:
            (one,) = super().type_cast_value(ctx, (text,))
            made.append(one if doubt is None else one.but(uncertainty=Uncertainty.parse(doubt)))
        return tuple(made)

    def _pairs(self, ctx: click.Context) -> list[tuple[str, str | None]]:
        """Data and the uncertainty of each, from the command line."""
        found: list[tuple[str, str | None]] = []
        for name, text in ctx.meta.get(ORDER, []):
            if name == "data":
                found.append((text, None))
            elif not found or found[-1][1] is not None:
                why = "Each --data may have one." if found else "It belongs to the --data before it, but there is none."
                raise click.BadParameter(f"{text!r}: {why}", ctx, self, param_hint="'--uncertainty'")
            else:
                found[-1] = found[-1][0], text
        return found


ORDER = "orograph.data"
"""Where the order of ``--data`` and ``--uncertainty`` is kept while a command line is parsed."""

uncertainty_option = click.option(
    "--uncertainty", cls=DataOption, multiple=True, expose_value=False, metavar="FILE|spread|ci90[,KEY=VALUE…]",
    help="Uncertainty of the preceding --data: spread (standard deviation) or ci90 (half of the central 90 %) of its "
    "members, or a raster of standard deviations. Keys: variable, band, time, member, range, style (transparency, "
    "noise, blur, saturation, whiteness, palette, glyphs, hatching; in films members: in turn, rate= a second).",
)  # fmt: skip


def _option(one: Described, name: str = "") -> Callable[[F], F]:
    """The command-line option that a field describes."""
    flag = f"--{one.key}"
    more: dict[str, Any] = {"help": spoken(one.help) + " Repeat it for each." * one.multiple}
    if one.shown:
        more["help"] += f"  [default: {spoken(one.shown)}]"
    elif one.default not in (None, (), False):
        more["show_default"] = True
    if one.multiple:
        more["multiple"] = True
    elif one.default is not None:
        more["default"] = one.default
    if one.kind is bool or (one.details is not None and one.read is None):
        if one.default is True:
            flag = f"{flag}/--no-{one.key}"
        else:
            more["is_flag"] = True
    else:
        more["type"] = _type(one)
        if one.metavar:
            more["metavar"] = one.metavar
    if one.name == "data":
        more["cls"] = DataOption
    if one.name == "detail":
        more |= {"is_flag": False, "flag_value": "fractal"}
    return click.option(flag, name or one.name, **more)


def _type(one: Described) -> click.ParamType[Any]:
    if one.read is not None:
        return Text(one)
    if one.choices:
        return click.Choice(one.choices)
    ranged = one.least is not None or one.most is not None
    if one.kind is int:
        least, most = (None if v is None else int(v) for v in (one.least, one.most))
        return click.IntRange(least, most) if ranged else click.INT
    if one.kind is float:
        return FloatRange(one.least, one.most) if ranged else Float()
    return click.STRING


def scene_options(without: tuple[str, ...] = (), backend: bool = True, **changes: dict[str, Any]) -> Callable[[F], F]:
    """Give a verb the options that say what is drawn and how.

    Args:
        without: options to omit. backend: whether to add ``--backend``.
        changes: overrides by option (``scene_option``).
    """

    def give(function: F) -> F:
        options: list[Callable[[Any], Any]] = []
        for name in SCENE:
            if name not in without:
                options.append(scene_option(name, **changes.get(name, {})))
                options += [_option(one, detail) for detail, one in DETAILS.get(name, {}).items()]
                options += [conservative_option] if name == "method" else []
                options += [uncertainty_option] if name == "data" else []
        options.append(grid_options("draw"))
        if backend:
            options.append(
                click.option(
                    "--backend",
                    type=click.Choice(["cpu", "gpu"]),
                    default="cpu",
                    show_default=True,
                    help="Where to draw; gpu falls back to the CPU if there is none (see orograph doctor).",
                )
            )
        return with_options(function, *options)

    return give


def inputs_of(paths: Sequence[str], options: Mapping[str, Any]) -> dict[str, Sequence[str | None]]:
    """The files that a picture is made from, by their roles (``files.check_outputs``)."""
    return {
        "the input": paths, "a layer of --drape": [layer.path for layer in options["layers"]],
        "the data of --data": [str(one.source) for one in options["data"]],
        "the example of --detail": [getattr(options.get("detail"), "exemplar", None)],
        "the camera of --mesh-view": [options["mesh_view"]], "the grid of --geoid": [options["geoid"]],
    }  # fmt: skip


def given_of(options: Mapping[str, Any], terrain: Terrain | None = None) -> dict[str, Any]:
    """A scene's options as given on the command line; those not given are left out.

    Args:
        terrain: what is drawn; None: with ``conservative``, what its method can promise for it is not checked.
    """
    given = {}
    for name in SCENE:
        value = options.get(name)
        if name in DETAILS and not value:
            continue
        if name in DETAILS:
            more = {one.name: options[detail] for detail, one in DETAILS[name].items()}
            kind = SCENE[name].details
            value = replace(value, **more) if isinstance(value, kind) else kind(**more)  # type: ignore[arg-type, misc, type-var]
        if value is not None and value != ():
            given[name] = value
    if options.get("conservative"):
        from orograph.scene.methods import check_promise, conservative_method

        backend = options.get("backend", "gpu")
        given["method"] = conservative_method(options["method"], backend)
        if terrain is not None:
            check_promise(given["method"], backend, terrain)
    return given


def check_scene(options: Mapping[str, Any], progress: Progress) -> tuple[ErrorKind, ...]:
    """Raise UsageError if the options of a scene contradict each other; warn about options without effect.

    Returns: the kinds of diamond errors that its method needs, for ``store.prepare``.
    """
    from orograph.geovis.color import color_table

    choice = None
    if options["method"] != "auto":
        choice = choice_of(options["method"], options["conservative"], options.get("backend", "gpu"))
        if choice.info.kind != "rays":
            choice.info.check_goal("tolerance" if options.get("triangles") is None else "triangles")
    check_options(given_of(options))
    color_table(options["colormap"])
    if options.get("title") is not None and not options["furniture"]:
        progress.warn("`title` is drawn with `furniture` only.")
    return () if choice is None else error_kinds([choice])


def scene_of(terrain: Terrain, view: View, options: Mapping[str, Any], max_memory: int, jobs: int | None) -> Scene:
    """The scene that the options describe, seen by a camera."""
    from orograph.scene.scene import Scene

    return Scene.of(terrain, view, max_memory=max_memory, jobs=jobs, **given_of(options, terrain))
