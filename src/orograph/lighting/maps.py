"""Maps of light written block by block, larger than memory, and resumed after an interruption."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph.lighting.context import Context, Options, Values
from orograph.lighting.products import Product, described, product
from orograph.lighting.raster import Band, write
from orograph.lighting.raster_resume import Checkpoint, identity
from orograph.progress import Progress
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.lighting.sun import Sun

AT_ONCE = ("normal", "slope", "aspect", "hillshade")
"""Products that are too quick to keep partial results of."""

_SKY = ("sky-view-factor", "sky-view-horizontal", "visible-sky", "openness", "openness-negative")
_SWEPT = ("horizon", *_SKY, "ambient-occlusion", "aperture", "shadow", "insolation", "sunshine")
USERS = {
    "azimuths": tuple(name for name in _SWEPT if name != "shadow"),
    "radius": _SWEPT,
    "curvature": _SWEPT,
    "refraction": _SWEPT,
    "sun": ("hillshade", "shadow"),
    "lights": ("hillshade",),
    "exaggeration": ("hillshade",),
    "rays": ("ambient-occlusion", "aperture"),
    "method": ("ambient-occlusion", "aperture"),
    "rho": ("ambient-occlusion",),
    "cones": ("ambient-occlusion",),
    "date": ("insolation", "sunshine"),
    "step": ("insolation", "sunshine"),
    "turbidity": ("insolation",),
}
"""The products that an option affects."""


def write_map(
    output: str | os.PathLike[str], terrain: Terrain, wanted: Sequence[str], options: Options, sun: Sun, *,
    byte: bool, resume: bool, jobs: int | None, max_memory: int, progress: Progress,
) -> list[Band]:  # fmt: skip
    """Write products as the bands of a Cloud Optimized GeoTIFF; returns the bands.

    Args:
        wanted: names of products. sun: that ``options`` have, for the file's tags.
        byte: 8-bit values for display. resume: keep finished work in ``OUTPUT.partial``, and go on from there.

    Raises:
        UsageError: options do not fit a product. OutputError: the file cannot be written, or the work there is other.
    """
    products = [product(name) for name in wanted]
    for each in products:
        each.check(options)
    if resume and set(wanted) <= set(AT_ONCE):
        progress.warn(f"`resume` does not apply to {', '.join(wanted)}: such maps are made in one go, in seconds.")
    bands = described(products, options)
    plan = {"products": list(wanted), "terrain": identity(terrain), "options": repr(options)}
    with _kept(os.fspath(output), plan) if resume else nullcontext() as kept:
        context = Context(terrain, options, jobs=jobs, max_memory=max_memory, progress=progress, kept=kept)
        write(
            output, terrain.grid, bands, _blocks(context, products), byte=byte, jobs=jobs, progress=progress,
            overviews="nearest" if {"aspect", "shadow"} & set(wanted) else "average",
            tags=_tags(context, wanted, sun),
        )  # fmt: skip
    return bands


@contextmanager
def _kept(output: str, plan: dict[str, Any]) -> Iterator[Checkpoint]:
    """The partial results of a map, kept until it is complete; only one process at a time makes it."""
    with alone(FolderStorage(output), "making this map"):
        kept = Checkpoint(Path(f"{output}.partial"), plan)
        try:
            yield kept
        except KeyboardInterrupt as stopped:
            stopped.add_note(f"{output} is not complete; run the same again to go on.")
            raise
        kept.remove()


def _blocks(context: Context, products: Sequence[Product]) -> Iterator[tuple[int, int, int, Values]]:
    """The blocks of all products with their first band; products with the same sweep share it."""
    from orograph.lighting.gather import produce

    counts = [len(each.bands(context.options)) for each in products]
    for k, row, col, values in produce(context, products):
        yield sum(counts[:k]), row, col, values


def _tags(context: Context, wanted: Sequence[str], sun: Sun) -> dict[str, str]:
    """What a file records about how it was made: the options that affect its products."""
    options, more = context.options, context.options.more
    lights = options.lights or ((*options.sun, 1.0),)
    method, rays = more.get("method", "horizon"), ("rays", "shadow-maps")
    said = {
        "azimuths": str(options.azimuths),
        "radius": "unlimited" if options.radius is None else f"{options.radius:g} m",
        "curvature": f"round, refraction {options.bending(context.terrain.grid.crs):g}"
        if options.curvature
        else "flat",
        "sun": f"azimuth {options.sun[0]:.6g}, altitude {options.sun[1]:.6g} degrees",
        "time": "" if sun.when is None else sun.when.isoformat(),
        "lights": "; ".join(f"azimuth {a:g}, altitude {h:g} degrees, weight {w:g}" for a, h, w in lights),
        "exaggeration": f"{options.exaggeration:g}",
        "method": method,
        "rays": str(options.rays) if method in rays else "",
        "rho": str(more.get("rho", "step")),
        "date": str(more.get("date", "")),
        "step": f"{more.get('step', 10.0):g} minutes",
        "turbidity": f"{more.get('turbidity', 3.0):g}",
    }
    if not options.lights:
        del said["lights"]
    elif "shadow" not in wanted:
        del said["sun"], said["time"]
    used = {
        key: text for key, text in said.items() if text and set(USERS["sun" if key == "time" else key]) & set(wanted)
    }
    return {"software": "orograph", "product": ", ".join(wanted), "terrain": context.terrain.name, **used}
