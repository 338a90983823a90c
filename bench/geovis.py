"""Data on the ground: the cost of each style, sign and kind of object over the bare picture, and the manual's pictures.

    python bench/geovis.py [--pictures FOLDER] [--quick | --uncertain] [--times N] [--only KIND ...]

The terrain is the orography of the western United Kingdom at 2 km. Its data are ERA5's temperature at noon on the days
of March 2019 (their mean, and their spread between days) if that file is there, and otherwise a synthetic field of 13
members. Each time is the median of three (``--times``) pictures of 900 × 640 pixels with kernels compiled: wall
seconds, and processor seconds, which say more on a busy machine. With ``--quick`` it is one picture with a ninth of the
pixels. ``--only T figure`` makes only the pictures of priorities and of figure 5 (rows by the beginnings of their
names).
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import geovis_volumes
import orograph
from horizon import fractal
from orograph import measuring
from orograph.geovis.data.dataset import Sign, Style
from orograph.geovis.data.standing import KINDS
from orograph.rendering.picture import Picture

SHARED = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
SIZE = geovis_volumes.SIZE
STRETCH = 40.0


def ground() -> Any:
    path = SHARED / "ukv-theta-over-orography" / "uk_orography_2km.tif"
    return (
        orograph.terrain(path, vertical_unit="metre") if path.exists() else orograph.terrain(fractal(257), spacing=30.0)
    )


def members() -> orograph.Dataset:
    path = SHARED / "fields-and-points" / "era5-2mt-2019-03-uk.grib"
    if path.exists():
        return orograph.Dataset(str(path), time="T12", uncertainty="spread", name="Temperature")
    y, x = np.mgrid[:40, :40] / 8
    field = np.sin(x) + np.cos(y) + np.random.default_rng(0).normal(0, 0.1 + 0.4 * (x > 2.5), (13, 40, 40))
    return orograph.Dataset(field, uncertainty="spread", name="A made field", band="all")


def quakes() -> tuple[Any, orograph.Dataset] | None:
    tiles = sorted((SHARED / "california-3s-tiles").glob("*.tif"))
    points = SHARED / "fields-and-points" / "earthquakes.geojson"
    if not tiles or not points.exists():
        return None
    return orograph.terrain([str(t) for t in tiles]), orograph.Dataset(
        str(points), variable="mag", colormap="magma", name="Magnitude"
    )


def shapes() -> dict[str, dict[str, Any]]:
    """Pictures of lines and polygons, by name."""
    from geovis_shapes import COLORS, hexagons, landcover, runs

    made: dict[str, dict[str, Any]] = {}
    folder = SHARED / "spdatalarge-zion-nz-ecuador"
    if (folder / "zion_nlcd2011.tif").exists():
        land = orograph.terrain(folder / "zion_srtm.tif", vertical_unit="metre")
        common = {"terrain": land, "view": orograph.camera.whole(land, SIZE)}
        cover = orograph.Dataset(landcover(folder / "zion_nlcd2011.tif"), colormap=COLORS, name="Land cover", width=0.6)
        made["classes of a raster"] = {**common, "data": orograph.Dataset(str(folder / "zion_nlcd2011.tif"))}
        made["classes"] = {**common, "data": cover}
        made["classes, hatching"] = {**common, "data": cover.but(style="hatching")}
        made["lines"] = {**common, "data": orograph.Dataset(runs(land), name="Fall", unit="m/km", colormap="plasma")}
    tiles = sorted((SHARED / "california-3s-tiles").glob("N3[67]W1*.tif"))
    points = SHARED / "fields-and-points" / "earthquakes.geojson"
    if tiles and points.exists():
        land = orograph.terrain([str(t) for t in tiles])
        doubt = orograph.Uncertainty("error", style="palette")
        made["polygons, palette"] = {
            "terrain": land, "exaggeration": 5,
            "view": orograph.camera.around(land, SIZE, azimuth=200, pitch=45, exaggeration=5),
            "data": orograph.Dataset(hexagons(points, "mag"), variable="mean", colormap="magma", uncertainty=doubt),
        }  # fmt: skip
    return made


def pairs_and_flows() -> dict[str, dict[str, Any]]:
    """Pictures of two components, or of two attributes in one colour, by name."""
    winds = SHARED / "fields-and-points" / "eraint_uvz.nc"
    warmth = SHARED / "fields-and-points" / "era5-2mt-2019-03-uk.grib"
    if not (winds.exists() and warmth.exists()):
        return {}
    wind = orograph.Dataset(str(winds), variable="u+v", band=3, name="Wind")
    noon, night = (
        orograph.Dataset(str(warmth), time=time, style="bivariate", name=name)
        for time, name in (("T12", "Noon"), ("T00", "Midnight"))
    )
    return {
        "flows": {"data": wind.but(style="lic")}, "arrows": {"data": wind.but(style="arrows")},
        "flows and arrows": {"data": [wind.but(style="lic"), wind.but(style="arrows", colormap="gray")]},
        "bivariate": {"data": [noon, night]},
    }  # fmt: skip


def tracks() -> dict[str, dict[str, Any]]:
    """Pictures of standing lines, by name: ways down, and a synthetic flight."""
    from geovis_shapes import collection, feature, runs

    path = SHARED / "spdatalarge-zion-nz-ecuador" / "zion_srtm.tif"
    if not path.exists():
        return {}
    land = orograph.terrain(path, vertical_unit="metre")
    view = orograph.camera.around(land, SIZE, azimuth=200, pitch=30, distance=None, exaggeration=2)
    common = {"terrain": land, "exaggeration": 2, "view": view}
    ways = orograph.Dataset(runs(land, 60), name="Fall", unit="m/km", colormap="plasma")
    x, y = land.grid.xy(land.grid.cols / 2, land.grid.rows / 2)
    turn = np.linspace(0, 6 * np.pi, 160)
    places = np.stack([x + 7000 * np.cos(turn), y + 7000 * np.sin(turn), 2200 + 150 * turn], 1)
    flight = collection([feature("LineString", places.tolist())], land.grid.crs.to_wkt())
    return {
        "tubes": {**common, "data": ways.but(style="tubes")},
        "tubes, in the air": {**common, "data": orograph.Dataset(flight, variable="z", style="tubes", name="Altitude")},
        "curtains": {**common, "data": ways.but(style="curtains")},
    }


def uncertain() -> None:
    """Seconds per million samples of one draw of an uncertain terrain, on all processors."""
    land = orograph.terrain(fractal(1025), spacing=30.0)
    low, high = land.height_range
    middle = land.grid.xy(512, 512)
    level = 0.5 * (low + high)
    measures: dict[str, Any] = {
        "slope": lambda error, draws: measuring.slope(land, error, [20.0], draws=draws),
        "contours": lambda error, draws: measuring.contours(land, error, interval=50.0, draws=draws),
        "flood": lambda error, draws: measuring.flood(land, level, [middle], error, draws=draws),
        "viewshed": lambda error, draws: measuring.probable_viewshed(land, middle, error, 100.0, draws=draws),
    }
    print("| a draw of | errors independent | correlated over 100 m | over 2 km |\n|---|---:|---:|---:|")
    for name, measure in measures.items():
        took = []
        for reach in (0.0, 100.0, 2000.0):
            error = measuring.HeightError(3.0, reach)
            measure(error, 2).values()
            began = time.perf_counter()
            measure(error, 10).values()
            took.append((time.perf_counter() - began) / 10 / (land.grid.rows * land.grid.cols / 1e6))
        print(f"| {name} | " + " | ".join(f"{seconds:.3f}" for seconds in took) + " |", flush=True)


def timed(times: int, **options: Any) -> tuple[Picture, float, float]:
    """A picture, and the medians of its wall and processor seconds."""
    if times > 1:
        orograph.render(**options)
    took, worked = [], []
    for _ in range(times):
        began, busy = time.perf_counter(), time.process_time()
        picture = orograph.render(**options)
        took.append(time.perf_counter() - began)
        worked.append(time.process_time() - busy)
    return picture, statistics.median(took), statistics.median(worked)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--pictures", type=Path, help="write the manual's pictures there")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--times", type=int, default=3, metavar="N")
    parser.add_argument("--uncertain", action="store_true", help="only the cost of drawing uncertain terrain")
    parser.add_argument("--only", nargs="+", metavar="KIND", help="only rows whose names begin with KIND, or figure")
    given = parser.parse_args()
    if given.uncertain:
        uncertain()
        return
    terrain, data, times = ground(), members(), 1 if given.quick else given.times
    view = orograph.camera.whole(terrain, SIZE, exaggeration=STRETCH)
    common: dict[str, Any] = {"terrain": terrain, "view": view, "exaggeration": STRETCH, "progress": False}
    made: dict[str, Picture] = {}

    def row(name: str, **options: Any) -> None:
        if given.only and not name.startswith(tuple(given.only)):
            return
        made[name], seconds, worked = timed(times, **{**common, **options})
        print(f"| {name} | {seconds:.2f} | {worked:.2f} |", flush=True)

    print("| picture | seconds | of processors |\n|---|---:|---:|")
    row("bare")
    for marks in product("+-", repeat=3):
        name = "".join(letter + mark for letter, mark in zip("TDU", marks))
        row(name, data=data, priority=name)
    for style in (one for one in Style.__args__ if one not in ("arrows", "lic", "bivariate", "classes")):  # type: ignore[attr-defined]
        row(f"style {style}", data=data.but(style=style, uncertainty=None))
    plain = data.but(uncertainty=None, style="continuous")
    row("member value p90", data=plain.but(value="p90"))
    row("member exceeds 10", data=plain.but(exceeds=10.0))
    row("focus lens", data=data, priority="T+D-U-", focus=orograph.Focus("lens", "T+D+U+"))
    row("a ghost", ghosts=orograph.Ghost(terrain, opacity=0.4))
    for sign in Sign.__args__:  # type: ignore[attr-defined]
        if sign not in ("errorbars", "members", "none"):
            doubt = orograph.Uncertainty("spread", style=sign)
            row(f"sign {sign}", data=data.but(style="continuous", uncertainty=doubt))
    found = quakes()
    if found is not None:
        land, points = found
        around = orograph.camera.around(land, SIZE, azimuth=200, pitch=40, distance=None, exaggeration=5)
        for style in KINDS:
            doubt = orograph.Uncertainty("rms") if style == "bars" else None
            row(
                f"standing {style}", terrain=land, view=around, exaggeration=5, priority="T+D+U+",
                data=points.but(style=style, uncertainty=doubt),
            )  # fmt: skip
    for name, options in pairs_and_flows().items():
        row(f"two {name}", **{**options, "priority": "T+D+U-"})
    for name, options in tracks().items():
        row(f"track {name}", **{**options, "priority": "T+D+U-"})
    for name, options in geovis_volumes.pictures().items():
        row(f"volume {name}", **{"priority": "T+D+U-", **options})
    for name, options in geovis_volumes.ghosts().items():
        row(f"ghost {name}", **options)
    with tempfile.TemporaryDirectory() as folder:
        for name, options in geovis_volumes.walks(Path(folder)).items():
            row(f"walk {name}", **{"priority": "T+D+U-", **options})
    for name, options in shapes().items():
        row(f"shape {name}", **{"exaggeration": 1, "priority": "T+D+U-", **options})
    if given.pictures is not None:
        figures = "abc" if not given.only or "figure" in given.only else ""
        for letter, name in zip(figures, ("T+D-U-", "T-D+U-", "T-D-U+")):
            made[f"figure-5{letter}"] = orograph.render(
                terrain, size=(1200, 720), exaggeration=STRETCH, data=data, priority=name, furniture=True,
                title=f"Noon in March 2019 ({name})", progress=False,
            )  # fmt: skip
        save(made, given.pictures)


COLUMNS = {"T": 4, "style": 4, "sign": 4, "standing": 3, "shape": 2, "two": 2, "track": 3, "volume": 2, "walk": 2,
           "ghost": 2}  # fmt: skip
"""Pictures side by side in the sheets, by kind."""


def save(made: dict[str, Picture], folder: Path) -> None:
    """The manual's pictures: figure 5 of the paper, and sheets of priorities, styles, signs and objects."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (one for one in made if one.startswith("figure")):
        made[name].save(folder / f"{name}.jpg")
    for kind, columns in COLUMNS.items():
        names = [name for name in made if name.startswith(kind + ("" if kind == "T" else " "))]
        if names:
            sheet(made, names, columns, folder / f"{'priorities' if kind == 'T' else kind + 's'}.jpg")


def sheet(made: dict[str, Picture], names: list[str], columns: int, path: Path) -> None:
    """Put pictures side by side, each with its name."""
    from PIL import Image, ImageDraw, ImageFont

    wide, tall, line = SIZE[0] // 2, SIZE[1] // 2, 26
    rows = -(-len(names) // columns)
    whole = Image.new("RGB", (columns * wide, rows * (tall + line)), (246, 244, 239))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(16)
    for i, name in enumerate(names):
        x, y = i % columns * wide, i // columns * (tall + line)
        whole.paste(Image.fromarray(made[name].pixels).resize((wide, tall), Image.Resampling.LANCZOS), (x, y + line))
        pen.text((x + 10, y + 4), name.partition(" ")[2] or name, (36, 40, 46), font)
    whole.save(path, quality=88)


if __name__ == "__main__":
    main()
