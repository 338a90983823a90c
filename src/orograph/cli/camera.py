"""The camera on the command line: its options, their contradictions, and the view that they describe.

``@camera_options`` gives a verb ``azimuth``, ``pitch``, ``distance``, ``lonlat``, ``look_at``, ``view_path``, ``fov``,
``projection`` and ``size`` (``CAMERA``); ``check_camera`` refuses contradictions before any work is done;
``camera_view`` makes the view once the terrain is known. Verbs that use them have ``exaggeration``, and may have
``furniture``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import FILE, Direction, F, Float, FloatRange, Numbers, ParamType, with_options
from orograph.scene.sizes import read_size

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from orograph.geovis.keys import Legend
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

PLACES = ("azimuth", "pitch", "distance", "lonlat", "look_at", "view_path", "fov")
"""Options that move the camera away from the view of the whole terrain."""

CAMERA = (*PLACES, "projection", "size")
"""All parameters that ``camera_options`` adds."""


SIZES = ": pixels (a width alone: 2400), or on paper 20x15cm, 8x6in@150 (dots per inch, else 300; recorded)"
"""The text about sizes in the help of every ``--size``."""


class Size(ParamType):
    """Pixels, WIDTHxHEIGHT, or a size on paper; converted to ``Pixels``."""

    name = "WIDTHxHEIGHT[UNIT][@DPI]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        try:
            size = read_size(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if size.dpi is not None:
            from orograph.rendering.metadata import check_dpi

            check_dpi(size.dpi)
        return size


def camera_options(function: F) -> F:
    """Give a verb the options that say where to look from."""
    return with_options(
        function,
        click.option(
            "--from",
            "azimuth",
            type=Direction(),
            metavar="AZIMUTH",
            help="Look from this side, degrees clockwise from north or a point of the compass (NE).  "
            "[default: 180, the south]",
        ),
        click.option(
            "--pitch",
            type=Float(),
            metavar="DEG",
            help="Look down by this angle; 90 is straight down.  [default: 42]",
        ),
        click.option(
            "--distance",
            type=Float(),
            metavar="M",
            help="Metres from the ground in the terrain's middle.  [default: far enough to see all of it]",
        ),
        click.option(
            "--lonlat",
            type=Numbers("LON,LAT,HEIGHT"),
            help="Stand here, HEIGHT metres above the zero of the heights.",
        ),
        click.option(
            "--look-at",
            type=Numbers("LON,LAT"),
            help="With --lonlat: look at the ground here.  [default: the terrain's middle]",
        ),
        click.option(
            "--view",
            "view_path",
            type=FILE,
            metavar="VIEW.json",
            help='The camera in a file: {"eye": [E, N, height], "target": […], "up": […], "fov_y": 40, "width": …, '
            '"height": …, "near": …, "far": …}, in the terrain\'s CRS, or longitude, latitude and height with '
            '"crs": "EPSG:4326".',
        ),
        click.option(
            "--fov",
            type=FloatRange(1e-6, 180, max_open=True),
            metavar="DEG",
            help="Vertical field of view.  [default: 30; with --lonlat 45; with --view the view's]",
        ),
        click.option(
            "--projection",
            type=click.Choice(["perspective", "plan"]),
            default="perspective",
            show_default=True,
            help="plan: a map, straight down with parallel rays; --from says which side is at the bottom.",
        ),
        click.option("--size", type=Size(), help=f"The picture's size{SIZES}.  [default: 1280x720, or the view's]"),
    )


def check_camera(options: Mapping[str, Any]) -> None:
    """Raise UsageError if the camera options contradict each other, or if --view's file holds no camera (ReadError if
    it cannot be read): before a terrain is read, which may take long."""
    from orograph.errors import UsageError

    oblique = [f"--{k}" for k in ("from", "pitch", "distance") if options["azimuth" if k == "from" else k] is not None]
    if options["look_at"] is not None and options["lonlat"] is None:
        raise UsageError("--look-at needs --lonlat: the place to stand at.")
    if sum([options["view_path"] is not None, bool(oblique), options["lonlat"] is not None]) > 1:
        raise UsageError("Give one camera: --view, or --from, --pitch and --distance, or --lonlat and --look-at.")
    if options["projection"] == "plan":
        wrong = [o for o in oblique if o != "--from"] + (["--lonlat"] if options["lonlat"] is not None else [])
        if wrong:
            raise UsageError(
                f"{wrong[0]} and --projection plan contradict each other: a plan shows the whole terrain, straight "
                "down.",
                remedy="Turn it with --from, or choose another extent with --view.",
            )
    if options["view_path"] is not None:
        from orograph.documents import load_object, naming
        from orograph.viewpoint import View

        values = load_object(options["view_path"], "view", "eye, target, fov_y, width and height")
        with naming(options["view_path"]):
            View.from_dict({**values, "crs": None})  # (its CRS is checked once the terrain's is known)


def is_fitted(options: Mapping[str, Any]) -> bool:
    """Whether the camera that the options describe is as near as shows everything."""
    return all(options[name] is None for name in ("view_path", "lonlat", "distance"))


def camera_view(
    terrain: Terrain, options: Mapping[str, Any], also: NDArray[np.float64] | None = None, keys: Sequence[Legend] = ()
) -> View:
    """The camera that the options describe (see ``check_camera``).

    Args:
        also: further positions to show, as for ``camera.whole``. keys: legend entries that are known already.
    """
    from dataclasses import replace

    from orograph.scene import camera
    from orograph.viewpoint import View

    def given(name: str, default: float) -> float:
        return default if options[name] is None else float(options[name])

    size = options["size"] or (1280, 720)
    if options["view_path"] is not None:
        view = View.load(options["view_path"], crs=terrain.grid.crs)
        if options["size"] is not None:
            view = view.resized(*size)
        if options["projection"] == "plan":
            view = replace(view, projection="plan")
        return replace(view, fov_y=given("fov", view.fov_y))
    azimuth = given("azimuth", 180.0)
    insets = camera.NO_INSETS
    if options.get("furniture"):
        from orograph.rendering.furniture import furnish as furniture

        insets = furniture.insets(size, terrain.attribution, options.get("layers") or (), keys)
    if options["projection"] == "plan":
        return camera.plan(terrain, size, azimuth=azimuth, insets=insets, also=also)
    if options["lonlat"] is not None:
        return camera.standing(terrain, size, options["lonlat"], options["look_at"], fov_y=given("fov", 45.0))
    return camera.around(
        terrain, size, azimuth=azimuth, pitch=given("pitch", 42.0), distance=options["distance"],
        fov_y=given("fov", 30.0), exaggeration=options["exaggeration"], insets=insets, also=also,
    )  # fmt: skip
