"""Pictures by the GPU beside those by the CPU: how much their colours differ, on real data.

    python bench/pictures.py [DATA] [--size 480x300] [--set NAME …]

DATA is the folder of open data sets (default: ``../shared/data`` beside the checkout). Seven of them, which
``tests/rendering/gpu/test_picture.py`` does not hold, are drawn whole, from above, at a slant, to the horizon, and from
a few samples away, with the options' defaults (sun, shadows, sky light, water). Told of each picture is the difference
of colour, ΔE*ab (CIE 1976), over all pixels: mean, 95th percentile and largest; and how many pixels show ground in one
of both alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from orograph.scene.prepare import prepare

from orograph.geovis.color_errors import lab
from orograph.gpu.device import open_device
from orograph.rendering.cpu.draw import draw as cpu_draw
from orograph.rendering.gpu.draw import draw as gpu_draw
from orograph.scene.camera import around, plan, whole
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SETS = {
    "gabilan": "lsd-topo/gabilan.tif",
    "spearfish": "spearfish-sfdem-utm13/sfdem.tiff",
    "saint-helens": "sainthelens-usgsdem/SainteHelens.dem",
    "vinschgau": "terra-vinschgau/elev_vinschgau.tif",
    "zion": "spdatalarge-zion-nz-ecuador/zion_srtm.tif",
    "fuji": "osgearth-srtm90m-volcano-voids/mt_fuji_90m.tif",
    "city": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
}
DATA = Path(__file__).parents[2] / "shared" / "data"


def views(terrain: Terrain, size: tuple[int, int]) -> Iterator[tuple[str, View]]:
    """The five views of a terrain, by their names."""
    rows, cols = terrain.grid.shape
    extent = max(rows, cols) * terrain.grid.spacing[0]
    eye, middle = (tuple(float(v) for v in terrain.grid.xy(cols / n, rows / n)) for n in (3, 2))
    height = terrain.height_range[1] + 5 * terrain.grid.spacing[0]
    yield "whole", whole(terrain, size)
    yield "above", plan(terrain, size)
    yield "slant", around(terrain, size, azimuth=215, pitch=30, distance=extent / 4)
    yield "horizon", View((*eye, height), (*middle, height), fov_y=45.0, width=size[0], height=size[1])
    yield "near", around(terrain, size, azimuth=120, pitch=35, distance=12 * terrain.grid.spacing[0])


def linear(pixels: np.ndarray) -> np.ndarray:
    """Linear sRGB, 0 to 1, of bytes (IEC 61966-2-1)."""
    c = pixels / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--size", default="480x300")
    parser.add_argument("--set", action="append", choices=SETS)
    given = parser.parse_args()
    size = tuple(int(n) for n in given.size.split("x"))
    device = open_device()
    print(f"{device.adapter.name}, {given.size}")
    print(f"{'':14}{'':10}{'mean':>7}{'95 %':>7}{'largest':>9}{'ground in one':>15}")
    worst = [0.0, 0.0]
    for name in given.set or SETS:
        terrain = prepare([str(given.data / SETS[name])])
        for kind, view in views(terrain, size):
            scene = Scene.of(terrain, view)
            ours, theirs = gpu_draw(scene, device=device), cpu_draw(scene)
            off = np.linalg.norm(lab(linear(ours.pixels)) - lab(linear(theirs.pixels)), axis=-1)
            mean, high = float(off.mean()), float(np.percentile(off, 95))
            alone = int((np.isfinite(ours.depth) != np.isfinite(theirs.depth)).sum())
            worst = [max(worst[0], mean), max(worst[1], high)]
            print(f"{name:14}{kind:10}{mean:7.2f}{high:7.2f}{off.max():9.1f}{alone:15d}", flush=True)
    print(f"{'at most':24}{worst[0]:7.2f}{worst[1]:7.2f}")


if __name__ == "__main__":
    main()
