"""``orograph measure slope``, ``contours``, ``flood`` and uncertain viewsheds: probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from orograph.cli.camera import CAMERA, camera_options, check_camera
from orograph.cli.files import TIFF, check_ending
from orograph.cli.measuring import POINTS, Measure, Point, of_terrain, on_terrain, opened, points_option, tell, without
from orograph.cli.options import FILE, F, Float, progress_of, with_options
from orograph.errors import UsageError
from orograph.folders import temporary

if TYPE_CHECKING:
    from orograph.measuring import HeightError, Probable
    from orograph.store.terrain import Terrain

MARK = "#d55e00"
"""Colour of the eye, or of sources, in a picture."""


def error_options(function: F) -> F:
    """The error of heights, and how many terrains are drawn."""
    return with_options(
        function,
        click.option("--sigma", metavar="M|FILE", help="Standard deviation of heights, metres; or a raster of "
                                                       "standard deviations."),
        click.option("--range", "reach", type=Float(), default=0.0, metavar="M",
                     help="Distance at which the errors' correlation has dropped to 5 %.  [default: 0, independent]"),
        click.option("--horizontal", type=Float(), default=0.0, metavar="M",
                     help="Horizontal standard deviation; adds (M · tan slope)² to the variance."),
        click.option("--check-points", "checks", metavar="FILE[,KEY=VALUE…]",
                     help="Points with measured heights that all draws agree with (CSV, GeoJSON, or what OGR reads). "
                          "Keys: variable (of the heights), layer."),
        click.option("--check-sigma", type=Float(), default=0.0, metavar="M",
                     help="Standard deviation of the check points' heights, metres."),
        click.option("--draws", type=int, default=200, show_default=True, metavar="N",
                     help="Number of terrains to draw; a probability is uncertain by at most 1 / (2 √N)."),
        click.option("--seed", type=int, default=1, show_default=True, metavar="N", help="Seed of the draws."),
    )  # fmt: skip


def outputs_options(function: F) -> F:
    """``--output``, ``--picture`` and the picture's camera."""
    function = without("lonlat", "look_at")(camera_options(function))
    return with_options(
        function,
        click.option("--output", "-o", type=FILE, metavar="OUT.tif", help="The Cloud Optimized GeoTIFF to write."),
        click.option("--picture", type=FILE, metavar="OUT.png", help="A relief picture with the last band on it."),
    )


def height_error(
    sigma: str | None, reach: float, horizontal: float, checks: str | None = None, check_sigma: float = 0.0
) -> HeightError:  # fmt: skip
    """The error of heights that the options describe."""
    from orograph.measuring import HeightError

    if sigma is None and not horizontal:
        source = click.get_current_context().get_parameter_source
        for name in ("draws", "seed"):
            if source(name) is ParameterSource.COMMANDLINE:
                raise UsageError(f"--{name} applies to uncertain heights only.", remedy="Give --sigma or --horizontal.")
    if sigma is None:
        if reach:
            raise UsageError("--range applies to errors, whose size --sigma gives.")
        if checks is not None and not horizontal:
            raise UsageError("--check-points apply to uncertain heights only.", remedy="Give --sigma.")
        return HeightError(0.0, 0.0, horizontal, _checks(checks), check_sigma)
    try:
        value: Any = float(sigma)
    except ValueError:
        value = sigma
    return HeightError(value, reach, horizontal, _checks(checks), check_sigma)


def _checks(text: str | None) -> Any:
    """Check points, as text for people."""
    if text is None:
        return None
    from orograph.geovis.data.dataset import Dataset

    return Dataset.parse(text)


def check_files(
    output: str | None, picture: str | None, camera: dict[str, Any], endings: Sequence[str] = TIFF
) -> dict[str, Any]:  # fmt: skip
    """Raise UsageError unless there is something to write, with endings that fit, and the camera options agree."""
    if output is None and picture is None:
        raise UsageError("Give an output: --output out.tif, --picture out.png, or both.")
    camera = {**camera, "lonlat": None, "look_at": None, "exaggeration": 1.0}
    check_camera({k: camera[k] for k in CAMERA})
    if output is not None:
        check_ending("--output", output, endings)
    if picture is not None:
        from orograph.rendering.picture import picture_format

        picture_format(Path(picture))
    return camera


def written(
    ctx: click.Context, terrain: Terrain, found: Probable, output: str | None, picture: str | None,
    camera: dict[str, Any], marks: dict[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the requested files, and print a summary.

    Args:
        marks: places that the picture shows too, a name and columns x and y.
    """
    progress = progress_of(ctx)
    with temporary() as folder:
        path = output or str(Path(folder) / "probable.tif")
        facts = found.save(path, progress)
        if picture is not None:
            from orograph import Dataset
            from orograph.cli.camera import camera_view
            from orograph.measuring.probable import looks_of
            from orograph.rendering.api import render
            from orograph.scene.sizes import dpi_of

            data = [Dataset(path, band=len(found.bands), style="continuous", **looks_of(found.bands[-1]))]
            if marks is not None:
                data.append(Dataset({k: marks[k] for k in "xy"}, name=marks["name"], colormap={marks["name"]: MARK}))
            view = camera_view(terrain, {**camera, "furniture": True})
            render(
                terrain, view, data=data, furniture=True, max_memory=ctx.obj["max_memory"], jobs=ctx.obj["jobs"],
                progress=progress,
            ).save(picture, dpi=dpi_of(camera["size"]))  # fmt: skip
    return facts


def rows_of(found: Probable, facts: dict[str, Any]) -> list[tuple[str, str, str]]:
    """The summary, for people."""
    rows = [(name, f"{mean:.4g}{band.unit}", " on average")
            for band, (name, mean) in zip(found.bands, facts["means"].items())]  # fmt: skip
    if "expected_grid_m2" in facts:
        rows.append(("expected area", f"{facts['expected_grid_m2'] / 1e6:,.4f} km²", " on the grid"))
    sampled = f"at most ± {found.standard_error:.3f} (standard error)" if found.draws else "none: a closed form"
    return [*rows, ("draws", f"{found.draws:,}" if found.draws else "–", ""), ("sampling error", sampled, "")]


@click.command(
    "slope", cls=Measure, context_settings=POINTS, short_help="Slopes of uncertain heights: mean, spread, exceedance."
)
@of_terrain
@error_options
@click.option("--exceeds", type=Float(), multiple=True, metavar="DEG",
              help="Also the probability that the slope exceeds this; may be repeated.")  # fmt: skip
@outputs_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def slope(
    ctx: click.Context, /, sigma: str | None, reach: float, horizontal: float, checks: str | None,
    check_sigma: float, draws: int, seed: int,
    exceeds: tuple[float, ...], output: str | None, picture: str | None, as_json: bool, **camera: Any,
) -> None:  # fmt: skip
    """Mean and standard deviation of the slope of uncertain heights, degrees.

    The result is a raster with a band for each, and one for each --exceeds. Errors are drawn --draws times, correlated
    over --range.
    """
    camera = check_files(output, picture, camera)
    error = _needed(sigma, reach, horizontal, checks, check_sigma)
    terrain = opened(ctx, () if output is None else (output,), (picture,))
    from orograph import measuring

    found = measuring.slope(terrain, error, exceeds, draws=draws, seed=seed, **_means(ctx))
    _tell(ctx, terrain, found, output, picture, camera, as_json)


@click.command(
    "contours", cls=Measure, context_settings=POINTS, short_help="The probability of a contour line, cell by cell."
)
@of_terrain
@error_options
@click.option("--level", "levels", type=Float(), multiple=True, metavar="M",
              help="Height of a line; may be repeated.")  # fmt: skip
@click.option("--interval", type=Float(), metavar="M", help="Instead: the height between lines.")
@outputs_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def contours(
    ctx: click.Context, /, sigma: str | None, reach: float, horizontal: float, checks: str | None,
    check_sigma: float, draws: int, seed: int,
    levels: tuple[float, ...], interval: float | None, output: str | None, picture: str | None, as_json: bool,
    **camera: Any,
) -> None:  # fmt: skip
    """The probability that a contour line passes through a cell, given uncertain heights.

    The result has a value for each cell, between the samples.
    """
    camera = check_files(output, picture, camera)
    error = _needed(sigma, reach, horizontal, checks, check_sigma)
    terrain = opened(ctx, () if output is None else (output,), (picture,))
    from orograph import measuring

    found = measuring.contours(terrain, error, levels, interval=interval, draws=draws, seed=seed, **_means(ctx))
    _tell(ctx, terrain, found, output, picture, camera, as_json)


@click.command(
    "flood",
    cls=Measure,
    context_settings=POINTS,
    short_help="What lies below a water level and is connected to a source.",
)
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="[SOURCE]...")
@click.option("--level", type=Float(), required=True, metavar="M", help="Level of the water, in the terrain's heights.")
@error_options
@outputs_options
@points_option
@click.pass_context
def flood(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], level: float, sigma: str | None, reach: float,
    horizontal: float, checks: str | None, check_sigma: float, draws: int, seed: int, output: str | None,
    picture: str | None, degrees: bool, as_json: bool, **camera: Any,
) -> None:  # fmt: skip
    """Which ground is below a water level and connected to a source along such ground.

    Without a source all ground below the level counts. With --sigma the result is a probability; without it 1 or 0.
    """
    camera = check_files(output, picture, camera)
    error = height_error(sigma, reach, horizontal, checks, check_sigma)
    terrain = opened(ctx, () if output is None else (output,), (picture,))
    from orograph import measuring

    sources = on_terrain(measuring.Places(terrain), points, degrees) if points else None
    found = measuring.flood(terrain, level, sources, error, draws=draws, seed=seed, **_means(ctx))
    marks = None if sources is None else {"name": "Sources", "x": sources[:, 0], "y": sources[:, 1]}
    _tell(ctx, terrain, found, output, picture, camera, as_json, marks)


def viewshed(
    ctx: click.Context, terrain: Terrain, place: Any, error: HeightError, draws: int, seed: int, output: str | None,
    picture: str | None, camera: dict[str, Any], as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """The probability that ground is visible (``orograph measure viewshed … --sigma``)."""
    from orograph import measuring

    found = measuring.probable_viewshed(terrain, place, error, draws=draws, seed=seed, **options, **_means(ctx))
    marks = {"name": "Eye", "x": [float(place[0])], "y": [float(place[1])]}
    _tell(ctx, terrain, found, output, picture, camera, as_json, marks)


def _needed(
    sigma: str | None, reach: float, horizontal: float, checks: str | None, check_sigma: float
) -> HeightError:  # fmt: skip
    if sigma is None and not horizontal:
        raise UsageError("Give the uncertainty of heights: --sigma 2 (metres), or a raster of standard deviations.")
    return height_error(sigma, reach, horizontal, checks, check_sigma)


def _means(ctx: click.Context) -> dict[str, Any]:
    return {"max_memory": ctx.obj["max_memory"], "jobs": ctx.obj["jobs"]}


def _tell(
    ctx: click.Context, terrain: Terrain, found: Probable, output: str | None, picture: str | None,
    camera: dict[str, Any], as_json: bool, marks: dict[str, Any] | None = None,
) -> None:  # fmt: skip
    facts = written(ctx, terrain, found, output, picture, camera, marks)
    whole = {"measure": found.measure, **found.error.tags, "seed": found.seed, **found.tags, **facts}
    tell(ctx, terrain, whole, rows_of(found, facts), as_json, tuple(filter(None, (output, picture))))
