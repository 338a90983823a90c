"""``orograph demo``: from a file in degrees to a picture, with the sample that comes with matplotlib."""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path

import click

from orograph.cli.options import progress_of


@click.command("demo")
@click.option(
    "--output",
    "-o",
    type=click.Path(file_okay=False, path_type=Path),
    default="orograph-demo",
    show_default=True,
    help="Folder for the sample and its picture; created if needed.",
)
@click.pass_context
def command(ctx: click.Context, /, output: Path) -> None:
    """Draw the built-in sample (Jacksboro fault, Tennessee), report how long each step took and what to try next.

    The sample is real: 344 × 403 heights of the Shuttle Radar Topography Mission in degrees, which matplotlib ships.
    The first run compiles Orograph's kernels, once for this machine.
    """
    progress = progress_of(ctx)
    steps: list[tuple[str, float]] = []
    clock = time.perf_counter()

    def step(name: str) -> None:
        nonlocal clock
        steps.append((name, time.perf_counter() - clock))
        clock = time.perf_counter()
        progress.note(f"{name:<58} {steps[-1][1]:6.2f} s")

    from orograph.errors import OutputError
    from orograph.sample import write_jacksboro

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"The folder cannot be made: {error.strerror}.", path=output) from error
    dem = write_jacksboro(output)
    step(f"the sample, as a GeoTIFF in degrees: {dem}")

    from orograph.lighting.sun import Sun
    from orograph.rendering.cpu.draw import draw
    from orograph.scene.camera import whole
    from orograph.scene.scene import Scene
    from orograph.store.prepare import prepare

    terrain = prepare([str(dem)], progress=progress)
    rows, cols = terrain.grid.shape
    crs = terrain.grid.crs
    step(f"read and projected to metres ({crs.name if crs else 'local'}, {cols} × {rows})")
    view = whole(terrain, (1280, 720), azimuth=160, pitch=38)
    scene = Scene.of(terrain, view, sun=Sun(315, 35), furniture=True, title="Jacksboro fault, Tennessee")
    with progress.task("Drawing"):
        picture = draw(scene, progress)
    step("drawn, with sun, shadows and the light of the sky")
    out = picture.save(output / "jacksboro.png")
    step("written")
    click.echo(f"\nThe picture: {out}\n")
    # The plain name is not found if Orograph is installed in a virtual environment that is not active.
    beside = Path(sys.executable).with_name("orograph")
    called = "orograph" if shutil.which("orograph") or not beside.exists() else os.path.relpath(beside)
    click.echo(
        f"Try next:\n  {called} info {dem}\n  {called} render {dem} -o map.png --projection plan --furniture\n  "
        f"{called} render {dem} -o dusk.png --from 140 --pitch 18 --distance 14000 --sun 270,20 --sky --exaggeration "
        f"1.5\n  {called} build {dem} -o jacksboro.oro\nand the same with your own DEM."
    )
