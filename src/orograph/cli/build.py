"""``orograph build``: build a store from DEM files."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.build_types import ErrorKinds, MaxError
from orograph.cli.memory import megabytes, peak_memory
from orograph.cli.options import (
    FILE,
    Float,
    area_options,
    cluster_options,
    jobs_option,
    memory_option,
    progress_of,
    resampling_option,
    source_options,
    vertical_options,
)
from orograph.cli.products import Names
from orograph.cli.sections import Verb
from orograph.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyproj import CRS

    from orograph.error import ErrorKind
    from orograph.store.stored import StoredTerrain


@click.command("build", cls=Verb, short_help="Build a terrain store from DEM files, or from points.")
@click.argument("dem", nargs=-1, type=click.Path())
@click.option("--output", "-o", "store", required=True, metavar="STORE", help="Folder or URL (s3://…) of the store.")
@area_options
@click.option("--crs", help="Projected CRS of the terrain.  [default: the files' own, or their UTM zone]")
@click.option("--resolution", type=Float(), metavar="METRES", help="Distance between samples.  [default: as the files]")
@resampling_option
@click.option(
    "--errors",
    type=ErrorKinds(),
    default="exact",
    show_default=True,
    help="Which diamond errors are stored: some of exact,wedgie,midpoint, or none.",
)
@click.option(
    "--tins",
    type=click.Choice(["4", "8", "16", "32"]),
    help="Also store TINs of patches for bdam: segments along the leg of a finest patch (bdam's default: 16).",
)
@click.option(
    "--for",
    "methods",
    multiple=True,
    metavar="NAME[,key=value…]",
    help="Also store what a method needs with these options (see orograph methods); may be repeated.",
)
@click.option(
    "--color-errors",
    is_flag=True,
    help="Also store how much coarser triangles change the lit colours of --drape or the tint (for --color-tolerance).",
)
@click.option("--drape", type=FILE, metavar="IMAGE", help="With --color-errors: the image laid over the terrain.")
@click.option(
    "--keep-source/--no-keep-source",
    default=True,
    show_default=True,
    help="If files are resampled to another grid, also keep their original samples, for the heights of places.",
)
@click.option(
    "--codec",
    type=click.Choice(["portable", "compact", "smallest", "progressive"]),
    default="portable",
    show_default=True,
    help="How quantised heights are packed: portable is what every reader of Zarr understands; compact, 0.2 to 0.7 "
    "of the size, and smallest, smaller still and slower, are read by Orograph (and by zarr-python where it is "
    "installed); progressive stores each level as its difference from the level above: the fewest bytes of heights.",
)
@click.option(
    "--max-error",
    type=MaxError(),
    default="lossless",
    show_default=True,
    help="How far heights may differ from the files', in metres; auto: keep the data's own steps; lossless: float32.",
)
@source_options
@click.option(
    "--skip-damaged",
    is_flag=True,
    default=None,
    help="Leave out files that cannot be opened, and name them.",
)
@vertical_options
@memory_option
@jobs_option
@click.option("--overwrite", is_flag=True, help="Replace an existing store; it stays until the new one is complete.")
@click.option(
    "--bake",
    "products",
    type=Names(),
    metavar="NAMES",
    help="Also bake light: sky-view-factor,aperture… (orograph bake has options for it).",
)
@click.option("--resume", is_flag=True, help="Finish an interrupted build of the same files with the same options.")
@click.option(
    "--update",
    is_flag=True,
    help="Rebuild only what depends on files that were added, changed or removed, in a folder or a bucket; builds the "
    "store if there is none.",
)
@click.option(
    "--keep",
    type=click.IntRange(min=1),
    metavar="N",
    help="With --update: versions to keep, including the new one; STORE@2 opens the second.  [default: 2]",
)
@click.option(
    "--shard",
    type=click.IntRange(min=1),
    metavar="N",
    help="Samples along a side of a file of the store, a power of two.  [default: 2048, or less where memory is short]",
)
@click.option(
    "--chunk",
    type=click.IntRange(min=1),
    default=256,
    show_default=True,
    metavar="N",
    help="Samples along a side of what readers fetch at once, a power of two.",
)
@click.option("--part", metavar="I/N", help="Make only this part of the heights (for job arrays), such as 3/64.")
@click.option("--finish", is_flag=True, help="Make the rest of a store whose parts are all there.")
@cluster_options("Build", ", which share --max-memory")
@click.option(
    "--repair",
    is_flag=True,
    help="Rebuild what orograph check finds damaged; DEM may be left out if the store records its files.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    dem: tuple[str, ...],
    store: str,
    overwrite: bool,
    resume: bool,
    update: bool,
    keep: int | None,
    repair: bool,
    max_memory: int,
    jobs: int | None,
    errors: tuple[ErrorKind, ...],
    methods: tuple[str, ...],
    tins: str | None,
    color_errors: bool,
    drape: str | None,
    products: tuple[str, ...] | None,
    keep_source: bool,
    codec: str,
    max_error: str | float,
    as_json: bool,
    shard: int | None,
    chunk: int,
    part: str | None,
    finish: bool,
    workers: int | None,
    dask: str | None,
    **options: Any,
) -> None:
    """Build a terrain store from DEM files: one raster at all its resolutions, read tile by tile.

    Many files become one terrain; degrees become metres (the UTM zone, unless --crs says otherwise); a projected raster
    is kept sample for sample. The original samples of resampled files are kept as well: the surface is drawn from the
    grid, the height of a place comes from the samples. The store is a Zarr v3 hierarchy that other tools read as well.

    A file of points (CSV with x, y, z or longitude, latitude, height; LAS, LAZ; GeoPackage, GeoJSON and what else OGR
    reads) is gridded by linear interpolation over its Delaunay triangulation, and the points are kept: --resolution is
    the distance between samples (by default the points' mean distance), --max-edge leaves long triangles out.

    DEM may be a store. Built from itself, it gets what it lacks of --errors, --tins and --for; its heights stay. Under
    another name it is copied: a part of it, or with another codec.

    An interrupted build (Ctrl-C, a full disk, a crash) leaves STORE.partial, and --resume finishes it to the same
    bytes. An incomplete store does not open.

    \b
    Examples:
      orograph build dem.tif -o area.oro
      orograph build tiles/*.tif -o area.oro --resolution 10 --max-memory 2GiB
      orograph build tiles/*.tif -o area.oro --resume
      orograph build tiles/*.tif -o area.oro --update --keep 5
      orograph build tiles/*.tif -o s3://bucket/area.oro --update
      orograph build dem.tif -o area.oro --for roam,error=wedgie --for soar
      orograph build area.oro -o area.oro --for bdam
      orograph build dem.tif -o area.oro --max-error 0.1
      orograph build dem.tif -o area.oro --color-errors --drape ortho.tif
      orograph build tiles/*.tif -o area.oro --bake sky-view-factor,aperture
      orograph build N44W072.hgt -o area.oro --to-vertical ellipsoidal --geoid egm96_15.gtx
      orograph build tiles/*.tif -o area.oro --part 3/64
      orograph build tiles/*.tif -o area.oro --finish
      orograph build tiles/*.tif -o area.oro --workers 4 --jobs 1 --max-memory 4GiB
      orograph build points.laz -o area.oro --resolution 1 --max-edge 50
      orograph build -o area.oro --repair
    """
    # (One function, though long: most of it is its options and their help.)
    if repair:
        _repair(ctx, dem, store, max_memory, jobs, as_json, options)
        return
    if not dem:
        raise click.UsageError("Missing argument 'DEM...'.", ctx)
    from orograph.store.adding import is_itself
    from orograph.store.addresses import storage_at
    from orograph.store.build import build
    from orograph.store.given import source_of
    from orograph.verbs.build import check_completing
    from orograph.verbs.needed import Needed, needed_by

    check_completing(products or (), color_errors, drape, part)
    progress = progress_of(ctx)
    needed = needed_by(methods, progress, Needed(errors, None if tins is None else int(tins)))
    started = time.perf_counter()
    source = source_of(dem, progress, **options)
    try:
        terrain: StoredTerrain | None = build(
            source,
            store,
            overwrite=overwrite,
            resume=resume,
            update=update,
            keep=keep,
            max_memory=max_memory,
            jobs=jobs,
            **needed._asdict(),
            keep_source=keep_source,
            codec=codec,
            max_error=max_error,
            progress=progress,
            shard=shard,
            chunk=chunk,
            part=part,
            finish=finish,
            workers=workers,
            dask=dask,
        )
    except KeyboardInterrupt:
        again = " again" if update or finish or part else " with --resume" + " in place of --overwrite" * overwrite
        what = f"Part {part}" if part else "The new store" if overwrite or update else store
        said = f"{what} is not complete; run the same command{again} to finish it."
        if is_itself(source, storage_at(store)) and not (overwrite or update):
            said = f"{store} is as it was; run the same command again to finish adding to it."
        click.echo(f"\n{said}", err=True)
        raise
    if terrain is None:
        click.echo(json.dumps({"path": store, "part": part}) if as_json else f"{store}: part {part} is made")
        return
    if products:
        from orograph.cli.bake import run

        terrain.close()
        terrain = run(store, products, progress, max_memory=max_memory, jobs=jobs, workers=workers, dask=dask)
        assert terrain is not None
    if color_errors:
        from orograph.geovis.color_store import store_colors

        terrain.close()
        try:
            terrain = store_colors(
                store, drape, max_memory=max_memory, jobs=jobs, progress=progress, workers=workers, dask=dask
            )
        except KeyboardInterrupt:
            click.echo(
                f"\n{store} is complete but for its color errors; run the same command with --resume to finish them.",
                err=True,
            )
            raise
    _report(terrain, time.perf_counter() - started, as_json, getattr(source, "skipped", ()))


def _report(terrain: StoredTerrain, seconds: float, as_json: bool, skipped: Sequence[str]) -> None:
    """Print what was built, as text or as JSON."""
    from orograph.store.colors import COLORS

    grid, size = terrain.grid, terrain.size_bytes
    low, high = terrain.height_range
    known = low == low
    result = {
        "path": terrain.url,
        "version": terrain.version,
        "size_bytes": size,
        "shape": list(grid.shape),
        "levels": terrain.levels,
        "side": terrain.side,
        "crs": crs_name(grid.crs),
        "spacing_m": list(grid.spacing),
        "height_range": [low, high] if known else None,
        "valid_fraction": terrain.valid_fraction,
        "errors": list(terrain.errors),
        "color_errors": COLORS.of(terrain.record) or None,
        "layers": list(terrain.layers),
        "vertical_datum": terrain.vertical,
        "resampled": None if terrain.resampled is None else terrain.resampled.to_json(),
        "codec": None if terrain.record.coding is None else terrain.record.coding.to_json(),
        "keeps_source": terrain.samples is not None,
        "skipped": list(skipped),
        "seconds": round(seconds, 3),
        "peak_memory_bytes": peak_memory(),
    }
    if as_json:
        click.echo(json.dumps(result))
        return
    x, y = grid.spacing
    spacing = f"{x:.6g} m" if abs(x - y) < 1e-6 * x else f"{x:.6g} × {y:.6g} m"
    click.echo(
        f"{terrain.url}: {megabytes(size)}, {grid.cols} × {grid.rows} samples at {spacing}, {grid.crs_name}\n"
        f"{terrain.levels} level{'s' if terrain.levels != 1 else ''}, side {terrain.side}; "
        + (f"heights {low:.1f} to {high:.1f} m, " if known else "no valid height, ")
        + f"{100 * terrain.valid_fraction:.4g} % valid\n"
        + (f"resampled: {terrain.resampled}\n" if terrain.resampled is not None else "")
        + (f"codec: {terrain.record.coding}\n" if terrain.record.coding is not None else "")
        + f"built in {seconds:.1f} s, peak memory {megabytes(peak_memory())}"
    )


def _repair(
    ctx: click.Context, dem: tuple[str, ...], store: str, max_memory: int, jobs: int | None, as_json: bool,
    options: dict[str, Any],
) -> None:  # fmt: skip
    """Repair a store and print what was repaired."""
    from orograph.store.given import source_of
    from orograph.store.repair import repair

    others = {
        "overwrite",
        "resume",
        "update",
        "keep",
        "products",
        "errors",
        "tins",
        "keep_source",
        "codec",
        "max_error",
        "color_errors",
        "drape",
        "part",
        "finish",
        "workers",
        "dask",
        *(() if dem else options),
    }
    for option in ctx.command.params:
        name = str(option.name)
        if name in others and ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise UsageError(
                f"--repair cannot be combined with {option.opts[0]}.",
                remedy="It restores the store from the files and options that it was built with.",
            )
    progress = progress_of(ctx)
    source = source_of(dem, progress, **options) if dem else None
    mended = repair(store, source, max_memory=max_memory, jobs=jobs, progress=progress)
    if as_json:
        click.echo(json.dumps({"path": store, "mended": mended}))
        return
    for key in mended:
        click.echo(f"{key}: mended")
    click.echo(f"{store}: {'nothing was damaged' if not mended else 'sound again'}")


def crs_name(crs: CRS | None) -> str | None:
    """The authority's code of a CRS; its WKT if it has none."""
    if crs is None:
        return None
    authority = crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else str(crs.to_wkt())
