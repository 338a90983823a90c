"""Sheets of pictures: the eight priorities, the four classes of data and reference, and the three scenarios.

    python bench/geovis_sheets.py FOLDER [--only SET ...] [--size 900x640]

Writes each picture, and one sheet for each set of data. The sets, if their files are there:

- ``britain``: ERA5's temperature at noon on the days of March 2019, their mean and spread, on orography of 2 km.
- ``california``: earthquakes of a week, with the root mean square of their residuals, and their means in hexagons.
- ``bathymetry``: a survey of the sea bed, its nominal depth, and its stated uncertainty.
- ``geoids``: the difference of two geoids of Switzerland on one of them, with synthetic standard deviations.
- ``season``: the 13 members of a seasonal forecast of temperature (GloSea4), coarse, on the orography of ``britain``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import orograph
from geovis import SHARED, STRETCH, ground, members
from geovis_shapes import hexagons

SCENARIOS = "approach", "overflight", "replanning"
EIGHT = ["".join(letter + mark for letter, mark in zip("TDU", marks)) for marks in product("+-", repeat=3)]

Set = tuple[dict[str, Any], orograph.Dataset, orograph.Dataset]
"""A set's common options, its data on the surface, and its data standing on it."""


def britain() -> Set:
    data = members()
    common = {"terrain": ground(), "exaggeration": STRETCH}
    return common, data, data.but(style="bars", size=26_000)


def california() -> Set:
    tiles = sorted((SHARED / "california-3s-tiles").glob("N3[67]W1*.tif"))
    points = SHARED / "fields-and-points" / "earthquakes.geojson"
    mean = orograph.Dataset(
        hexagons(points, "mag"), variable="mean", uncertainty=orograph.Uncertainty("error"), name="Mean magnitude"
    )
    single = orograph.Dataset(str(points), variable="mag", uncertainty="rms", style="bars", name="Magnitude")
    common = {"terrain": orograph.terrain([str(t) for t in tiles]), "exaggeration": 5}
    return common, mean, single


def bathymetry() -> Set:
    bag = SHARED / "fields-and-points" / "sample.bag"
    doubt = orograph.Uncertainty(str(bag), band=2)
    data = orograph.Dataset(str(bag), band=3, uncertainty=doubt, name="Nominal depth", unit="m")
    return {"terrain": orograph.terrain(bag), "exaggeration": 0.3}, data, data.but(style="cones")


def geoids() -> Set:
    from geovis_volumes import ghosts

    made = ghosts()["two geoids"]
    land = made["terrain"]
    heights = land.read(0, 0, land.grid.rows, 0, land.grid.cols)
    apart = np.asarray(made["ghosts"].source) - heights
    doubt = orograph.Uncertainty(0.02 + 0.5 * np.abs(np.gradient(apart, axis=0)).astype(np.float32))
    data = orograph.Dataset(apart, uncertainty=doubt, name="EGM2008 above CHGeo2004", unit="m")
    return {"terrain": land, "exaggeration": 6000}, data, data.but(style="discs")


def season() -> Set:
    path = SHARED / "glosea4-ensemble" / "members_surface_temperature_K.tif"
    data = orograph.Dataset(str(path), band="all", uncertainty="spread", name="Temperature", unit="K")
    return {"terrain": ground(), "exaggeration": STRETCH}, data, data.but(style="spheres")


SETS: dict[str, Callable[[], Set]] = {
    "britain": britain, "california": california, "bathymetry": bathymetry, "geoids": geoids, "season": season,
}  # fmt: skip


def pictures(made: Set, size: tuple[int, int]) -> dict[str, Any]:
    """The options of a set's pictures, by name."""
    common, flat, standing = made
    common = {**common, "size": size, "furniture": True, "progress": False}
    found = {name: {**common, "data": flat, "priority": name} for name in EIGHT}
    for dimension, data in (("A2", flat), ("A3", standing)):
        for space, view in (("R2", "plan"), ("R3", None)):
            found[f"{dimension}{space}"] = {**common, "data": data, "view": view, "priority": "T+D+U-"}
    return found | {name: {**common, "data": flat, "priority": name} for name in SCENARIOS}


def sheet(made: dict[str, Image.Image], columns: int) -> Image.Image:
    """Put pictures side by side, each with its name, at half their size."""
    one = next(iter(made.values()))
    wide, tall, line = one.width // 2, one.height // 2, 22
    rows = -(-len(made) // columns)
    whole = Image.new("RGB", (columns * wide, rows * (tall + line)), (246, 244, 239))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(15)
    for i, (name, picture) in enumerate(made.items()):
        x, y = i % columns * wide, i // columns * (tall + line)
        whole.paste(picture.resize((wide, tall), Image.Resampling.LANCZOS), (x, y + line))
        pen.text((x + 8, y + 3), name, (36, 40, 46), font)
    return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--size", default="900x640")
    given = parser.parse_args()
    wide, tall = (int(n) for n in given.size.split("x"))
    for name in given.only:
        folder = given.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        drawn: dict[str, Image.Image] = {}
        for kind, options in pictures(SETS[name](), (wide, tall)).items():
            picture = orograph.render(**options)
            drawn[kind] = Image.fromarray(picture.pixels)
            drawn[kind].save(folder / f"{kind}.png")
            print(name, kind, picture.describe(), flush=True)
        sheet(drawn, 3).save(given.folder / f"{name}.png")


if __name__ == "__main__":
    main()
