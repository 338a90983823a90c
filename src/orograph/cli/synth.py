"""``orograph synth``: make a fractal terrain, or one by example, of any size."""

from __future__ import annotations

from pathlib import Path

import click

from orograph.cli.files import check_ending, check_outputs
from orograph.cli.options import (
    Float,
    FloatRange,
    Numbers,
    cluster_options,
    jobs_option,
    memory_option,
    progress_of,
)


def _numbers(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
    """One or more numbers separated by commas."""
    return None if value is None else Numbers(",".join("R" * (value.count(",") + 1))).convert(value, param, ctx)


@click.command("synth")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    help="The GeoTIFF to write, or the store to build (.oro).",
)
@click.option(
    "--size", default="1025", show_default=True, metavar="N|ROWSxCOLS", help="Samples per side, or rows × columns."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed: each number gives another terrain.")
@click.option("--spacing", type=Float(), help="Metres between samples.  [default: 30, or the example's]")
@click.option("--crs", help="A projected CRS.  [default: EPSG:32633, or the example's]")
@click.option(
    "--relief",
    type=Float(),
    help="Metres from the lowest to the highest place.  [default: 6 % of the side, at most 2500]",
)
@click.option(
    "--roughness",
    type=FloatRange(0, 3),
    help="Depth of the finer furrows: 0 smooth, 1 natural.  [default: 1]",
)
@click.option(
    "--exemplar",
    metavar="FILE",
    help="Terrain to imitate, e.g. lidar: at most 4 million samples, none missing. It determines the spacing, the "
    "relief and the roughness.",
)
@click.option(
    "--jitter",
    callback=_numbers,
    metavar="R[,R…]",
    help="How much the pieces of the example vary, 0 to 1: one number, or one for each level from the coarsest on.  "
    "[default: 0.5, and 0 on the three finest]",
)
@click.option(
    "--passes",
    callback=_numbers,
    metavar="N[,N…]",
    help="With an example, how often its pieces are corrected, 0 to 2: one number, or one for each level; twice on "
    "all levels is ten times the work.  [default: 2, and 0 on the two finest]",
)
@click.option(
    "--over", metavar="FILE", help="Make colours for this terrain: --exemplar is a photo, --ground what it shows."
)
@click.option("--ground", metavar="FILE", help="With --over, the heights of the ground that the photo shows.")
@click.option(
    "--compress",
    type=click.Choice(["zstd", "deflate", "none"]),
    default="zstd",
    show_default=True,
    help="Compression of the file: zstd takes a third of the space of none, and reads half as fast from memory.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--resume", is_flag=True, help="Finish an interrupted store that was begun with the same options.")
@click.option("--part", metavar="I/N", help="Make only this part of a store's heights (for job arrays), such as 3/64.")
@click.option("--finish", is_flag=True, help="Make the rest of a store whose parts are all there.")
@memory_option
@jobs_option
@cluster_options("Build a store", ", which share --max-memory")
@click.pass_context
def command(
    ctx: click.Context,
    output: Path,
    size: str,
    seed: int,
    spacing: float | None,
    crs: str | None,
    relief: float | None,
    roughness: float | None,
    exemplar: str | None,
    jitter: tuple[float, ...] | None,
    passes: tuple[float, ...] | None,
    over: str | None,
    ground: str | None,
    compress: str,
    overwrite: bool,
    resume: bool,
    part: str | None,
    finish: bool,
    max_memory: int,
    jobs: int | None,
    workers: int | None,
    dask: str | None,
) -> None:
    """Make a terrain of any size: fractal plains, and ranges carved by rivers; or one that imitates an example; or
    colours for a terrain that imitate a photo (a layer for pictures: --drape).

    The same seed and size give the same file to the byte, whatever the number of jobs. The terrain is written in
    blocks, so any size works in a few hundred MiB of memory (building a store takes up to 1 GiB); the file appears
    under its name only when it is complete. The same command with --resume finishes an interrupted store (Ctrl-C, a
    full disk, a crash) to the same bytes.

    \b
    Examples:
      orograph synth -o hills.tif                              1025 × 1025 samples, 31 km a side
      orograph synth -o large.tif --size 16385 --seed 7        1 GiB: 35 s on two processors
      orograph synth -o strip.tif --size 2049x8193 --relief 800 --spacing 10
      orograph synth -o like.tif --exemplar lidar.tif --size 8193
      orograph synth -o like.oro --exemplar lidar.tif --size 65537
      orograph synth -o like.oro --exemplar lidar.tif --size 65537 --resume
      orograph synth -o like.oro --exemplar lidar.tif --size 65537 --workers 4 --max-memory 4GiB
      orograph synth -o colours.tif --over dem.tif --exemplar photo.tif --ground lidar.tif
    """
    from orograph.verbs.synth import STORE, check_output, colours, maker, write

    how = {"workers": workers, "dask": dask, "part": part, "finish": finish}
    check_output(output, overwrite, resume, how)
    if output.suffix.lower() != STORE:
        check_ending("--output", str(output))
    check_outputs({"--output": str(output)}, {"--exemplar": [exemplar], "--over": [over], "--ground": [ground]})
    if over is not None or ground is not None:
        said = {"--spacing": spacing, "--crs": crs, "--relief": relief, "--roughness": roughness, "--jitter": jitter,
                "--passes": passes}  # fmt: skip
        progress = progress_of(ctx)
        colours(over, exemplar, ground, output, seed, said, compress=compress, jobs=jobs, progress=progress)
        click.echo(f"{output}: colours for {over}, after {exemplar}")
        return
    made = maker(size, seed, spacing, crs, relief, roughness, exemplar, jitter, jobs, progress_of(ctx), passes=passes)
    try:
        write(
            made, output, compress=compress, overwrite=overwrite, resume=resume, jobs=jobs, progress=progress_of(ctx),
            max_memory=max_memory, **how,
        )  # fmt: skip
    except KeyboardInterrupt:
        if output.suffix.lower() == STORE:
            again = "again" if part or finish else "with --resume" + " in place of --overwrite" * overwrite
            click.echo(f"\n{output} is not complete; run the same command {again} to finish it.", err=True)
        raise
    if part is not None:
        click.echo(f"{output}: part {part} is made")
        return
    rows, cols = made.grid.shape
    apart = " × ".join(f"{metres:g}" for metres in dict.fromkeys(made.grid.spacing))
    click.echo(f"{output}: {rows} × {cols} samples, {apart} m apart, {made.name if exemplar else f'seed {seed}'}")
