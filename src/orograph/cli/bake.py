"""``orograph bake``: store light products as layers of a store, at all its levels."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import cluster_options, jobs_option, memory_option, progress_of
from orograph.cli.products import (
    Names,
    check_used,
    horizon_options,
    insolation_options,
    more_of,
    once,
    ray_options,
)
from orograph.errors import OutputError

if TYPE_CHECKING:
    from orograph.lighting.context import Options
    from orograph.progress import Progress
    from orograph.store.stored import StoredTerrain


@click.command("bake", short_help="Bake light into a store: sky, occlusion, apertures, at all levels.")
@click.argument("store", metavar="STORE")
@click.option(
    "--products",
    "--product",
    type=Names(),
    required=True,
    multiple=True,
    metavar="NAMES",
    help="What to bake (see above); separate with commas, or repeat.",
)
@horizon_options
@ray_options(
    ["horizon", "rays"],
    method="Method for ambient occlusion and apertures.  [default: horizon]",
    rays="With --by rays: rays per sample.",
)
@insolation_options
@click.option(
    "--bits",
    type=click.Choice(["8", "16"]),
    help="Bits per value in the store.  [default: 16 for apertures, insolation and sunshine, else 8]",
)
@click.option("--overwrite", is_flag=True, help="Bake existing layers again; restart an interrupted bake.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@memory_option
@jobs_option
@cluster_options("Bake", ", which share --max-memory")
@click.option("--part", metavar="I/N", help="Bake only this part (for job arrays), such as 3/64.")
@click.option("--finish", is_flag=True, help="Make the rest of a bake whose parts are all there.")
@click.pass_context
def command(
    ctx: click.Context, /, store: str, products: tuple[tuple[str, ...], ...], bits: str | None, overwrite: bool,
    as_json: bool, max_memory: int, jobs: int | None, workers: int | None, dask: str | None, part: str | None,
    finish: bool, **options: Any,
) -> None:  # fmt: skip
    """Bake light products into a store as layers: at all levels, averaged, quantised, readable by any Zarr tool.

    \b
    sky-view-factor, sky-view-horizontal, visible-sky   what is seen of the sky
    ambient-occlusion    share of ambient light (--radius, --rho, --by)
    aperture             the sky that is seen as one cap
    openness, openness-negative, horizon, insolation and sunshine (--date)

    render --light ao and --light aperture use what is baked. A layer of the same name is replaced when the new one is
    complete. An interrupted bake continues when the same command is run again.

    \b
    Examples:
      orograph bake area.oro --products sky-view-factor,aperture
      orograph bake area.oro --products ambient-occlusion --radius 600 --rho linear
      orograph bake area.oro --products sky-view-factor --workers 4 --max-memory 4GiB
      orograph bake area.oro --products sky-view-factor --radius 5000 --part 3/64
      orograph bake area.oro --products sky-view-factor --radius 5000 --finish
    """
    from orograph.lighting.context import Options

    began = time.perf_counter()
    wanted = once(products)
    check_used(ctx, wanted)
    chosen = Options(more=more_of(options), **options)
    terrain = run(
        store, wanted, progress_of(ctx), chosen, bits=None if bits is None else int(bits), overwrite=overwrite,
        max_memory=max_memory, jobs=jobs, workers=workers, dask=dask, part=part, finish=finish,
    )  # fmt: skip
    seconds = time.perf_counter() - began
    if terrain is None:
        said = {"path": store, "part": part, "seconds": round(seconds, 3)}
        click.echo(json.dumps(said) if as_json else f"{store}: part {part} is baked  {seconds:.1f} s")
        return
    if as_json:
        from orograph.cli.memory import peak_memory
        from orograph.store.layers import LAYERS

        layers = {name: LAYERS.of(terrain.record)[name].to_json() for name in wanted}
        told = {"path": terrain.url, "layers": layers, "size_bytes": terrain.size_bytes, "seconds": round(seconds, 3),
                "peak_memory_bytes": peak_memory()}  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
        return
    for name in wanted:
        layer = terrain.layer(name)
        band = layer.bands[0]
        error = f"within {band.error:.2g} {band.unit}" if band.unit != "1" else f"within {band.error:.2g}"
        count = f"{len(layer.bands)} bands of " if len(layer.bands) > 1 else ""
        levels = "1 level" if layer.levels == 1 else f"{layer.levels} levels"
        click.echo(f"{terrain.url}  {name}: {levels}, {count}{band.bits} bits ({error})")
    click.echo(f"baked in {seconds:.1f} s")


def run(
    store: str, names: Sequence[str], progress: Progress, options: Options | None = None, *, part: str | None = None,
    **how: Any,
) -> StoredTerrain | None:  # fmt: skip
    """As ``lighting.bake.bake``, but after Ctrl-C or on a full disk says how to continue."""
    from orograph.lighting.bake import bake

    shared = part or how.get("workers") or how.get("dask")
    resumes = "finished sweeps are kept" if shared or "://" not in store else "it starts from the beginning"
    again = f"orograph bake {store} again with the same {'part' if part else 'products'} to finish ({resumes})."
    try:
        return bake(store, names, options, progress=progress, part=part, **how)
    except KeyboardInterrupt:
        click.echo(f"\n{store} is as it was; run {again}", err=True)
        raise
    except OutputError as error:
        error.remedy = f"Check that the disk has room and that you may write to the folder, then run {again}"
        raise
