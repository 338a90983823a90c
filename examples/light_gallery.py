"""A sheet with each product of ``orograph light`` on one terrain: python examples/light_gallery.py DEM OUT.jpg …

Every panel is one map on the same window, with its key (the range of all but 1 % of its values at either end). Needs
Pillow, and colour maps by ``cmap``, which Orograph has anyway.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from cmap import Colormap
from PIL import Image, ImageDraw, ImageFont

import orograph
from orograph import lighting

GAP, HEAD = 12, 44
PAPER, INK, GREY = (247, 245, 239), (40, 40, 44), (110, 110, 116)

Pixels = np.ndarray
Paint = Callable[[np.ndarray], Pixels]
"""Values (rows, cols) as colours (rows, cols, 3), 0 to 255."""


def grey(low: float, high: float, power: float = 1.0) -> Paint:
    """From black at ``low`` to white at ``high``; missing values are paper."""

    def paint(values: np.ndarray) -> Pixels:
        part = np.clip((values - low) / (high - low), 0, 1) ** power
        return np.where(np.isnan(part)[..., None], PAPER, 255 * part[..., None])

    return paint


def colored(low: float, high: float, scale: str) -> Paint:
    """By a colour map; missing values are paper."""

    def paint(values: np.ndarray) -> Pixels:
        part = np.nan_to_num(np.clip((values - low) / (high - low), 0, 1))
        return np.where(np.isnan(values)[..., None], PAPER, 255 * np.asarray(Colormap(scale)(part))[..., :3])

    return paint


def vectors(v: np.ndarray) -> Pixels:
    """Unit vectors (3, rows, cols), east, north, up, as red, green and blue."""
    return np.where(np.isnan(v[0])[..., None], PAPER, np.moveaxis(127.5 * (1 + v[:3]), 0, -1))


CODES = {
    "missing": PAPER,
    "lit": (250, 236, 190),
    "penumbra": (214, 160, 90),
    "self": (60, 64, 84),
    "cast": (96, 122, 168),
}


def codes(values: np.ndarray) -> Pixels:
    """Codes of shadows."""
    return np.array(list(CODES.values()), float)[np.nan_to_num(values).astype(int)]


def ends(values: np.ndarray, share: float = 1.0) -> tuple[float, float]:
    """The range that all but ``share`` % of the values at either end lie in."""
    low, high = np.nanpercentile(values, [share, 100 - share])
    return float(low), float(max(high, low + 1e-6))


@dataclass
class Panel:
    """A map, and what is written over it: a ramp from ``low`` to ``high`` with its ends, or a note."""

    name: str
    pixels: Pixels
    note: str = ""
    paint: Paint | None = None
    low: float = 0.0
    high: float = 1.0
    unit: str = ""


def panels(terrain: orograph.Terrain, args: argparse.Namespace) -> Iterator[Panel]:
    """All maps, or those of ``args.only``."""
    radius = args.radius

    def made(name: str, **options: object) -> np.ndarray:
        if name not in ("normal", "slope", "aspect", "hillshade", "shadow"):
            options["azimuths"] = args.azimuths
        values: np.ndarray = lighting.make(terrain, name, **options).values
        return values

    def ramp(
        name: str, values: np.ndarray, unit: str = "", note: str = "", *, low: float | None = None,
        high: float | None = None, to: Callable[..., Paint] = grey, turned: bool = False, **more: object,
    ) -> Panel:  # fmt: skip
        a, b = ends(values)
        a, b = a if low is None else low, b if high is None else high
        paint = to(b, a, **more) if turned else to(a, b, **more)
        return Panel(name, paint(values), note, paint, a, b, unit)

    yield Panel("normal", vectors(made("normal")), "east, north, up as red, green, blue")
    yield ramp("slope", made("slope")[0], "°", low=0.0, turned=True)
    yield ramp("aspect", made("aspect")[0], "°", low=0.0, high=360.0, to=colored, scale="romaO")
    yield ramp("hillshade", made("hillshade", sun=(315, 45))[0], low=0.0, high=1.0)
    many = made("hillshade", lights=((315, 45, 2.0), (255, 40, 1.0), (15, 40, 1.0)))[0]
    yield ramp("hillshade", many, note="three lights", low=0.0, high=1.0)
    west = made("horizon")[args.azimuths * 3 // 4]
    yield ramp("horizon", west, "°", "in the west", low=0.0, turned=True, power=0.7)
    yield ramp("sky-view-factor", made("sky-view-factor")[0])
    yield ramp("sky-view-horizontal", made("sky-view-horizontal")[0])
    yield ramp("visible-sky", made("visible-sky")[0])
    yield ramp("openness", made("openness", radius=radius)[0], "°", f"R = {radius:g} m")
    yield ramp("openness-negative", made("openness-negative", radius=radius)[0], "°", f"R = {radius:g} m", turned=True)
    yield ramp("ambient-occlusion", made("ambient-occlusion")[0], note="rho a step, any distance")
    near = made("ambient-occlusion", radius=radius, rho="linear")[0]
    yield ramp("ambient-occlusion", near, note=f"rho linear, R = {radius:g} m")
    caps = made("aperture")
    yield Panel("aperture", vectors(np.stack([*(2.0 * caps[:2]), caps[2]])), "direction, its lean doubled")
    yield ramp("aperture", caps[3], "°", "radius")
    fraction, code = made("shadow", sun=args.sun)
    cosine = made("hillshade", sun=args.sun)[0]
    yield ramp("shadow", fraction * cosine, note="fraction, by the cosine", low=0.0, high=0.75, power=0.7)
    yield Panel("shadow", codes(code), "code")
    direct, diffuse, _ = made("insolation", date=args.date) / 1000
    yield ramp("insolation", direct, " kWh/m2", f"direct, {args.date}", to=colored, scale="inferno")
    yield ramp("insolation", diffuse, " kWh/m2", f"diffuse, {args.date}", to=colored, scale="inferno")
    year = made("insolation", date=args.date[:4])[2] / 1e6
    yield ramp("insolation", year, " MWh/m2", f"global, {args.date[:4]}", to=colored, scale="inferno")


def sheet(terrain: orograph.Terrain, args: argparse.Namespace) -> Image.Image:
    """All panels, ``args.wide`` in a row, each with its name and key over it; a scale on the first."""
    size, wide = args.panel, args.wide
    all_of_them = [panel for panel in panels(terrain, args) if not args.only or panel.name in args.only]
    rows = -(-len(all_of_them) // wide)
    out = Image.new("RGB", (wide * (size + GAP) + GAP, rows * (size + HEAD + GAP) + GAP), PAPER)
    draw = ImageDraw.Draw(out)
    title, small = ImageFont.load_default(17), ImageFont.load_default(12)
    for k, panel in enumerate(all_of_them):
        x, y = GAP + k % wide * (size + GAP), GAP + k // wide * (size + HEAD + GAP)
        picture = Image.fromarray(np.clip(panel.pixels, 0, 255).astype(np.uint8))
        way = Image.Resampling.NEAREST if panel.note == "code" else Image.Resampling.LANCZOS
        out.paste(picture.resize((size, size), way), (x, y + HEAD))
        draw.text((x, y), panel.name, INK, title)
        draw.text((x, y + 23), panel.note, GREY, small)
        if panel.note == "code":
            right = x + size
            for name in reversed([n for n in CODES if n != "missing"]):
                right -= draw.textlength(name, small) + 22
                draw.rectangle((right, y + 26, right + 9, y + 35), CODES[name])
                draw.text((right + 13, y + 23), name, GREY, small)
        elif panel.paint is not None:
            long = size * 2 // 5
            strip = panel.paint(np.linspace(panel.low, panel.high, long)[None].repeat(9, 0))
            out.paste(Image.fromarray(np.clip(strip, 0, 255).astype(np.uint8)), (x + size - long, y + 7))
            low, high = f"{panel.low:.3g}", f"{panel.high:.3g}{panel.unit}"
            draw.text((x + size - long, y + 23), low, GREY, small)
            draw.text((x + size - draw.textlength(high, small), y + 23), high, GREY, small)
    metres = np.hypot(terrain.grid.transform.a, terrain.grid.transform.d) * terrain.grid.cols / size  # a pixel's
    length = next(n for e in range(5, -1, -1) for n in (5 * 10**e, 2 * 10**e, 10**e) if n / metres < size / 3)
    text = f"{length // 1000} km" if length >= 1000 else f"{length} m"
    x, y = GAP + 12, GAP + HEAD + size - 14
    for color, grow in ((INK, 2), ((255, 255, 255), 0)):
        draw.rectangle((x - grow, y - grow, x + length / metres + grow, y + 2 + grow), color)
    draw.text((x, y - 20), text, (255, 255, 255), small, stroke_width=2, stroke_fill=INK)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem")
    parser.add_argument("out")
    parser.add_argument("--window", type=int, nargs=4, metavar=("ROW", "COL", "ROWS", "COLS"))
    parser.add_argument("--radius", type=float, default=600.0, help="of openness and occlusion, metres")
    parser.add_argument("--sun", default="2026-12-21T08:30-08:00")
    parser.add_argument("--date", default="2026-12-21")
    parser.add_argument("--azimuths", type=int, default=32)
    parser.add_argument("--only", nargs="*", help="panels of these products")
    parser.add_argument("--wide", type=int, default=4, help="panels in a row")
    parser.add_argument("--panel", type=int, default=340, help="pixels along its side")
    args = parser.parse_args()
    from orograph.store import MemoryTerrain
    from orograph.store.prepare import prepare

    terrain = prepare([args.dem])
    if args.window:
        row, col, rows, cols = args.window
        heights = terrain.read(0, row, row + rows, col, col + cols)
        grid = terrain.grid
        moved = grid.transform @ type(grid.transform).translation(col, row)
        terrain = MemoryTerrain(heights, orograph.Grid((rows, cols), moved, grid.crs), terrain.name)
    sheet(terrain, args).save(args.out, quality=84, optimize=True)


if __name__ == "__main__":
    main()
