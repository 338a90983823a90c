"""A sheet with each product of ``orograph light`` on one terrain: python examples/light_gallery.py DEM OUT.jpg …

Every panel is one map on the same window, in grey unless it says otherwise, with its range under its name. Needs Pillow
and Matplotlib's colour maps by ``cmap``, which Orograph has anyway.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from cmap import Colormap
from PIL import Image, ImageDraw, ImageFont

import orograph
from orograph import light

GAP, HEAD = 8, 34
PAPER, INK, GREY = (247, 245, 239), (40, 40, 44), (120, 120, 126)


def grey(values: np.ndarray, low: float, high: float, power: float = 1.0) -> np.ndarray:
    """Values (rows, cols) as greys (rows, cols, 3) from black at ``low`` to white at ``high``."""
    part = np.clip((values - low) / (high - low), 0, 1) ** power
    return np.repeat((255 * np.nan_to_num(part, nan=0.93))[..., None], 3, -1)


def coloured(values: np.ndarray, low: float, high: float, name: str) -> np.ndarray:
    """Values (rows, cols) by a colour map; missing ones are paper."""
    out = 255 * np.asarray(Colormap(name)(np.nan_to_num(np.clip((values - low) / (high - low), 0, 1))))[..., :3]
    out[np.isnan(values)] = PAPER
    return out


def vectors(v: np.ndarray) -> np.ndarray:
    """Unit vectors (3, rows, cols), east, north, up, as red, green and blue."""
    return np.moveaxis(np.nan_to_num(127.5 * (1 + v[:3]), nan=240), 0, -1)


def ends(values: np.ndarray, share: float = 1.0) -> tuple[float, float]:
    """The range that all but ``share`` % of the values at either end lie in."""
    low, high = np.nanpercentile(values, [share, 100 - share])
    return float(low), float(max(high, low + 1e-6))


def sheet(terrain: orograph.Terrain, args: argparse.Namespace) -> Image.Image:
    """All panels, four in a row."""
    radius, size = args.radius, args.panel
    panels: list[tuple[str, str, np.ndarray]] = []

    def made(name: str, **options: object) -> np.ndarray:
        values: np.ndarray = light.make(terrain, name, azimuths=args.azimuths, **options).values
        return values

    def add(name: str, values: np.ndarray, paint: Callable[[np.ndarray, float, float], np.ndarray], unit: str,
            low: float | None = None, high: float | None = None) -> None:  # fmt: skip
        found = ends(values)
        a, b = found[0] if low is None else low, found[1] if high is None else high
        panels.append((name, f"{a:.3g} to {b:.3g}{unit}", paint(values, a, b)))

    panels.append(("normal", "east, north, up as red, green, blue", vectors(made("normal"))))
    add("slope", made("slope")[0], lambda v, a, b: 255 - grey(v, a, b), "°, steep is dark", 0.0)
    aspect = coloured(made("aspect")[0], 0.0, 360.0, "twilight_shifted")
    panels.append(("aspect", "north purple, east blue, south white, west red", aspect))
    add("hillshade", made("hillshade", sun=(315, 45))[0], grey, "", 0.0, 1.0)
    many = made("hillshade", lights=((315, 45, 2.0), (255, 40, 1.0), (15, 40, 1.0)))[0]
    add("hillshade, three lights", many, grey, "", 0.0, 1.0)
    add(
        "horizon in the west",
        made("horizon")[args.azimuths * 3 // 4],
        lambda v, a, b: 255 - grey(v, a, b, 0.7),
        "°, high is dark",
        0.0,
    )
    add("sky-view-factor", made("sky-view-factor")[0], grey, "")
    add("visible-sky", made("visible-sky")[0], grey, "")
    add("openness", made("openness", radius=radius)[0], grey, f"°, R = {radius:g} m")
    add("openness-negative", made("openness-negative", radius=radius)[0], lambda v, a, b: 255 - grey(v, a, b),
        f"°, R = {radius:g} m, high is dark")  # fmt: skip
    add("ambient-occlusion", made("ambient-occlusion")[0], grey, "")
    near = made("ambient-occlusion", radius=radius, rho="linear")[0]
    add("ambient-occlusion, linear", near, grey, f", R = {radius:g} m")
    caps = made("aperture")
    steep = 2.0 * caps[:2]
    panels.append(("aperture: direction", "twice its lean, as red and green", vectors(np.stack([*steep, caps[2]]))))
    add("aperture: radius", caps[3], grey, "°")
    fraction = made("shadow", sun=args.sun)[0]
    cosine = made("hillshade", sun=args.sun)[0]
    panels.append(("shadow, and cosine of the sun", args.sun, grey(fraction * cosine, 0, 0.75, 0.7)))
    energy = made("insolation", date=args.date)[2] / 1000
    add("insolation", energy, lambda v, a, b: coloured(v, a, b, "inferno"), f" kWh per m2, {args.date}")

    wide = 4
    rows = -(-len(panels) // wide)
    out = Image.new("RGB", (wide * (size + GAP) + GAP, rows * (size + HEAD + GAP) + GAP), PAPER)
    draw, fonts = ImageDraw.Draw(out), [ImageFont.load_default(s) for s in (15, 12)]
    for k, (name, note, pixels) in enumerate(panels):
        x, y = GAP + k % wide * (size + GAP), GAP + k // wide * (size + HEAD + GAP)
        picture = Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).resize(
            (size, size), Image.Resampling.LANCZOS
        )
        out.paste(picture, (x, y + HEAD))
        draw.text((x, y), name, INK, fonts[0])
        draw.text((x, y + 17), note, GREY, fonts[1])
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
    parser.add_argument("--panel", type=int, default=300, help="pixels along its side")
    args = parser.parse_args()
    from orograph.picture.prepare import prepare
    from orograph.store import MemoryTerrain

    terrain = prepare([args.dem])
    if args.window:
        row, col, rows, cols = args.window
        heights = terrain.read(0, row, row + rows, col, col + cols)
        grid = terrain.grid
        moved = grid.transform @ type(grid.transform).translation(col, row)
        terrain = MemoryTerrain(heights, orograph.Grid((rows, cols), moved, grid.crs), terrain.name)
    sheet(terrain, args).save(args.out, quality=86)


if __name__ == "__main__":
    main()
