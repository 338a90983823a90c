"""What is drawn, on the command line: the options of all verbs that draw, each declared once.

``@scene_options`` gives a verb ``sun`` (a ``lighting.sun.SunSource``), what ``SCENE`` lists, ``water``, ``mesh_view``,
and ``crs``, ``resolution`` and ``backend``; ``check_scene`` refuses what contradicts, before any work; ``scene_of``
makes the scene of a view.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.layers import layers_of_options, layers_option
from orograph.cli.lights import check_lights, light_options, lights_of
from orograph.cli.lines import LINE_OPTIONS, LINES, contours_of, silhouettes_of
from orograph.cli.options import FILE, F, Float, ParamType, grid_options
from orograph.cli.refining import choice_of, error_kinds, method_option
from orograph.cli.suns import sun_option

if TYPE_CHECKING:
    from orograph.error import ErrorKind
    from orograph.progress import Progress
    from orograph.scene.scene import Scene
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View


class Water(ParamType):
    """auto, none, or a level in metres."""

    name = "auto|none|METRES"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if isinstance(value, float) or value in ("auto", "none"):
            return float(value) if isinstance(value, float) else str(value)
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither auto, none nor a level in metres.", param, ctx)


SCENE = ("shadows", "light", "rays", "exaggeration", "colormap", "sky", "relief", "samples", "tolerance",
         "method", "triangles", "wireframe", "furniture", "title")  # fmt: skip
"""Options that are a scene's attributes of the same name."""

DRAWING = {*SCENE, *LINES, "layers", "sun", "water", "lamps", "discs", "mesh_view", "backend", "conservative"}
"""All of them that are not about reading."""


def scene_options(function: F) -> F:
    """Give a verb the options that say what is drawn, and how."""
    for option in reversed(
        [
            sun_option(),
            light_options,
            click.option(
                "--exaggeration",
                type=Float(),
                default=1.0,
                show_default=True,
                metavar="X",
                help="Stretch heights on the screen.",
            ),
            click.option(
                "--relief",
                type=Float(),
                metavar="X",
                help="Stretch slopes for shading only; 1 is nature.  [default: 1 to 6, more for gentle land]",
            ),
            click.option(
                "--colormap",
                metavar="NAME",
                help="Colours of heights: alpine, mars, grey or any name of the cmap catalogue.  [default: alpine]",
            ),
            layers_option,
            click.option(
                "--water",
                type=Water(),
                metavar="auto|none|METRES",
                default="auto",
                show_default=True,
                help="auto: level areas are lakes and seas; a number: all ground up to that height.",
            ),
            *LINE_OPTIONS,
            click.option("--sky", is_flag=True, help="Draw sky and haze, instead of paper."),
            click.option("--furniture", is_flag=True, help="Add a title, a colour bar, a north arrow and a scale bar."),
            click.option("--title", help="The title (with --furniture).  [default: the file's name]"),
            click.option(
                "--samples",
                type=click.IntRange(1, 1024),
                default=4,
                show_default=True,
                help="Rays per pixel where the picture has edges; 1: jagged ones.",
            ),
            click.option(
                "--tolerance",
                type=Float(),
                metavar="PX",
                help="Pixels by which the ground may be displaced; 0 draws every sample.  "
                "[default: 0 up to 16.8 million samples, else 0.5; with a --method 1]",
            ),
            method_option(
                "Draw the mesh that this method makes within --tolerance, with light on its faces; auto: the terrain "
                "itself, by rays on the CPU, by patches on the GPU.",
                default="auto",
                show_default=True,
            ),
            click.option(
                "--triangles",
                type=click.IntRange(min=2),
                metavar="N",
                help="With a --method, instead: at most so many.",
            ),
            click.option(
                "--wireframe", is_flag=True, help="With a --method: draw its triangles' edges over the relief."
            ),
            click.option(
                "--mesh-view",
                type=FILE,
                metavar="VIEW.json",
                help="With a --method: the camera to select for, to look at the mesh from elsewhere.  "
                "[default: the picture's]",
            ),
            grid_options("draw"),
            click.option(
                "--backend",
                type=click.Choice(["cpu", "gpu"]),
                default="cpu",
                show_default=True,
                help="What draws; gpu: the CPU instead where there is none (see orograph doctor).",
            ),
        ]
    ):
        function = option(function)
    return function


def check_scene(options: Mapping[str, Any], progress: Progress) -> tuple[ErrorKind, ...]:
    """Raise UsageError where what is said of a scene contradicts itself; warn of what has no effect.

    Returns: the kinds of errors of diamonds that its method needs, for ``scene.prepare``.
    """
    from orograph.errors import UsageError
    from orograph.geovis.color import color_table

    choice = None
    if options["method"] != "auto":
        choice = choice_of(options["method"], options["conservative"], options["backend"])
    if choice is None or choice.info.kind == "rays":
        for name in ("triangles", "wireframe", "mesh_view"):
            if options[name]:
                raise UsageError(
                    f"--{name.replace('_', '-')} is about the mesh that a method makes.",
                    remedy="Choose one, such as --method soar.",
                )
    else:
        choice.info.check_goal("tolerance" if options["triangles"] is None else "triangles")
    if options["triangles"] is not None and options["tolerance"] is not None:
        raise UsageError("Give one goal: --tolerance or --triangles.")
    color_table(options["colormap"])
    layers_of_options(options)
    check_lights(options)
    if options["title"] is not None and not options["furniture"]:
        progress.warn("--title is drawn with --furniture only.")
    return () if choice is None else error_kinds([choice])


def scene_of(terrain: Terrain, view: View, options: Mapping[str, Any], max_memory: int, jobs: int | None) -> Scene:
    """The scene that the options describe, seen by a camera."""
    from orograph.scene.scene import Scene
    from orograph.viewpoint import View

    mesh_view = options["mesh_view"]
    lamps, discs = lights_of(terrain, options)
    return Scene.of(
        terrain, view, sun=options["sun"].over(terrain.grid),
        mesh_view=None if mesh_view is None else View.load(mesh_view, crs=terrain.grid.crs),
        water=None if options["water"] == "none" else options["water"], max_memory=max_memory, jobs=jobs,
        contours=contours_of(options), silhouettes=silhouettes_of(options), layers=layers_of_options(options),
        lamps=lamps, discs=discs,
        **{k: options[k] for k in SCENE},
    )  # fmt: skip
