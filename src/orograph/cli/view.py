"""``orograph view``: explore a terrain in a window."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.camera import CAMERA, camera_options, camera_view, check_camera
from orograph.cli.options import Bytes, jobs_option, progress_of, source_of, source_options, vertical_options
from orograph.cli.scenes import DRAWING, check_scene, given_of, scene_options
from orograph.cli.sections import Verb
from orograph.scene.parts import check_options

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

WINDOW = (1280, 800)
OWN = {*DRAWING, *CAMERA, "adapter"}
"""The options about the window; all other options are about reading."""

NOT_HERE = (
    "relief",
    "sky",
    "furniture",
    "inset",
    "title",
    "samples",
    "triangles",
    "wireframe",
    "mesh_view",
    "detail",
)
"""Options of pictures that the window's panels have, or that do not apply to a window."""


TOLERANCE = {"help": "Pixels by which the ground may be displaced on the screen.", "least": 1e-3, "shown": "1"}
"""What the window's help says differently about this option."""


@click.command("view", cls=Verb)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@camera_options
@scene_options(NOT_HERE, backend=False, tolerance=TOLERANCE)
@click.option("--gpu-memory", type=Bytes(), default="512MiB", show_default=True, help="GPU memory for tiles.")
@click.option(
    "--memory", "max_memory", type=Bytes(), default="1GiB", show_default=True, help="Memory for tables and caches."
)
@click.option(
    "--adapter",
    metavar="NAME",
    help="The GPU: a part of its name, or software.  [default: $OROGRAPH_ADAPTER, or the best]",
)
@click.option(
    "--screenshot", type=click.Path(dir_okay=False), metavar="OUT.png", help="Save what the window shows, and close it."
)
@click.option(
    "--frames",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Frames before the --screenshot, or fewer if nothing changes any more.",
)
@source_options
@vertical_options
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], gpu_memory: int, max_memory: int, screenshot: str | None,
    frames: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Explore a DEM (one file or many) or a store in a window.

    F1 or ? shows all keys. Left drag moves the ground, right drag orbits, the wheel zooms to the cursor, a double click
    goes there, W A S D fly. A large DEM is built into a store first, which is kept: the next time it opens at once.

    \b
    Examples:
      orograph view N44W072.hgt
      orograph view tiles/*.tif --sun 2026-06-21T19:30-07:00
      orograph view area.oro --view VIEW.json --exaggeration 1.5
    """
    from orograph.viewer.app import Warm, check, hurry, renderer_of, settle, show

    hurry()
    progress = progress_of(ctx)
    check_camera(options)
    check_options(given_of(options))
    if options["projection"] == "plan" and options["view_path"] is None:
        options["projection"] = "perspective"  # the window turns it straight down
        options["pitch"] = 90.0
    with progress.task("Loading Orograph"):
        check()
        warm = Warm(options["adapter"])
        from orograph.errors import UsageError
        from orograph.output import check_folder
        from orograph.scene.methods import mesh_choice
        from orograph.store.detect import is_store
        from orograph.store.prepare import prepare
        from orograph.viewer.session import Session

    # Report errors of the command line before any work is done.
    warm.device()
    errors = check_scene(options, progress)
    mesh_choice(options["method"], "gpu")
    if screenshot is not None:
        if Path(screenshot).suffix.lower() != ".png":
            raise UsageError("A screenshot is a PNG.", path=screenshot, remedy="Give it the ending .png.")
        check_folder(Path(screenshot))
    source = source_of(options, OWN)
    size = options["size"] or WINDOW
    if len(paths) > 1 or not is_store(paths[0]):
        settle()  # building may take long, and keeps to a memory budget
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, errors=errors, **source)
    with progress.task("Looking at the terrain"):
        session = Session(terrain, _view(terrain, options, size), size=size, paths=paths, **given_of(options, terrain))
    make = renderer_of(gpu_memory, max_memory, jobs)
    show(
        session, size=size, make=make, adapter=options["adapter"],
        screenshot=None if screenshot is None else Path(screenshot), frames=frames, warm=warm, progress=progress,
    )  # fmt: skip
    if screenshot is not None:
        click.echo(screenshot)


def _view(terrain: Terrain, options: dict[str, Any], size: tuple[int, int]) -> View | None:
    """The camera that the command line describes; None if it describes none."""
    said = any(options[name] is not None for name in ("azimuth", "pitch", "distance", "lonlat", "view_path", "fov"))
    return camera_view(terrain, {**options, "size": size}) if said else None
