"""Pictures by the GPU compared with those by the CPU: how much their colours differ, on real data.

    python bench/pictures.py [DATA] [--size 480x300] [--set NAME …] [--view NAME …] [--methods [--conservative]]
        [--tolerance 1]

DATA is the folder of open data sets (default: ``../shared/data`` beside the checkout). Seven of them, which
``tests/rendering/gpu/test_picture.py`` does not use, are drawn whole, from above, at a slant, to the horizon, and from
a few samples away, with the default options (sun, shadows, sky light, water). For each picture, the table has the
difference of colour, ΔE*ab (CIE 1976), over all pixels: mean, 95th percentile and largest; and the number of pixels
that show ground in only one of the two.

With ``--methods``, every method draws each view within the tolerance. First on the GPU with normals of the ground
(``normals="computed"``): these pictures, and the CPU's picture at full resolution, are compared with each other;
printed are the largest mean and the largest 95th percentile of any pair, with the pair, of all methods and of those
that promise the tolerance. Then with the normals of each
mesh's own faces, the default for meshes, on both backends; printed are the largest differences between the backends for
any method. Anything that the terrain or a backend does not support is named. With ``--conservative`` only methods that
promise the tolerance are compared, with the options that this takes, and only in the light of the ground.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orograph.errors import OrographError
from orograph.geovis.color_errors import lab
from orograph.gpu.device import Device, open_device
from orograph.lod.registry import METHODS, chosen, promised
from orograph.rendering.cpu.draw import draw as cpu_draw
from orograph.rendering.gpu.draw import draw as gpu_draw
from orograph.scene.camera import around, plan, whole
from orograph.scene.scene import Scene
from orograph.store.prepare import prepare
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
VIEWS = "whole", "above", "slant", "horizon", "near"


def views(terrain: Terrain, size: tuple[int, int], wanted: list[str] | None) -> Iterator[tuple[str, View]]:
    """The views of a terrain with these names (``VIEWS``), or all."""
    every = zip(VIEWS, five(terrain, size), strict=True)
    return ((name, view) for name, view in every if wanted is None or name in wanted)


def five(terrain: Terrain, size: tuple[int, int]) -> Iterator[View]:
    """The five views of a terrain."""
    rows, cols = terrain.grid.shape
    extent = max(rows, cols) * terrain.grid.spacing[0]
    eye, middle = (tuple(float(v) for v in terrain.grid.xy(cols / n, rows / n)) for n in (3, 2))
    height = terrain.height_range[1] + 5 * terrain.grid.spacing[0]
    yield whole(terrain, size)
    yield plan(terrain, size)
    yield around(terrain, size, azimuth=215, pitch=30, distance=extent / 4)
    yield View((*eye, height), (*middle, height), fov_y=45.0, width=size[0], height=size[1])
    yield around(terrain, size, azimuth=120, pitch=35, distance=12 * terrain.grid.spacing[0])


def linear(pixels: np.ndarray) -> np.ndarray:
    """Linear sRGB, 0 to 1, from bytes (IEC 61966-2-1)."""
    c = pixels / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def distance(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """ΔE of two pictures: mean and 95th percentile."""
    off = np.linalg.norm(one - other, axis=-1)
    return float(off.mean()), float(np.percentile(off, 95))


def promising() -> list[str]:
    """The methods that promise a tolerance, with the options that this takes."""
    found = []
    for method in METHODS:
        with contextlib.suppress(OrographError):
            found.append(str(promised(method)))
    return found


def drawn(
    terrain: Terrain, view: View, device: Device, tolerance: float, conservative: bool
) -> dict[str, np.ndarray]:  # fmt: skip
    """A view by every method, in CIELAB: "ground", "gpu" and "cpu", each with the method's name."""
    ways: dict[str, tuple[Callable[[Scene], Any], dict[str, Any]]] = {
        "ground": (partial(gpu_draw, device=device), {"normals": "computed"}),
        "gpu": (partial(gpu_draw, device=device), {}),
        "cpu": (cpu_draw, {}),
    }
    if conservative:
        ways = {"ground": ways["ground"]}
    pictures = {"ground cpu": lab(linear(cpu_draw(Scene.of(terrain, view)).pixels))}
    for method, (way, (draw, options)) in itertools.product(promising() if conservative else METHODS, ways.items()):
        try:
            picture = draw(Scene.of(terrain, view, method=method, tolerance=tolerance, **options))
        except OrographError as error:
            if (method, way) != ("hybrid", "cpu"):
                print(f"  {way} {method}: {error}")
            continue
        pictures[f"{way} {method}"] = lab(linear(picture.pixels))
    return pictures


def furthest(pictures: dict[str, np.ndarray], pairs: Iterable[tuple[str, str]]) -> str:
    """The largest mean difference of any of the pairs, and the largest 95th percentile."""
    off = {pair: distance(pictures[pair[0]], pictures[pair[1]]) for pair in pairs}
    mean, high = (max(off, key=lambda pair, k=k: off[pair][k]) for k in (0, 1))  # type: ignore[misc]
    return f"mean {off[mean][0]:.2f} ({' / '.join(mean)}), 95 % {off[high][1]:.2f} ({' / '.join(high)})"


def compared(pictures: dict[str, np.ndarray]) -> str:
    """The largest differences of any pair with the ground's normals, and between backends with the mesh's own."""
    grounds = [name for name in pictures if name.startswith("ground")]
    kept = [name for name in grounds if name == "ground cpu" or chosen(name.split()[1]).conservative]
    own = [(f"gpu {m}", f"cpu {m}") for m in METHODS if {f"gpu {m}", f"cpu {m}"} <= pictures.keys()]
    found = [f"{len(kept)} that keep a promise: {furthest(pictures, itertools.combinations(kept, 2))}"]
    if own:
        found.insert(
            0, f"{len(grounds)} in the ground's light: {furthest(pictures, itertools.combinations(grounds, 2))}"
        )
        found.append(f"{len(own)} in their own: {furthest(pictures, own)}")
    return "; ".join(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--size", default="480x300")
    parser.add_argument("--set", action="append", choices=SETS)
    parser.add_argument("--view", action="append", choices=VIEWS)
    parser.add_argument("--methods", action="store_true", help="compare all methods with each other")
    parser.add_argument("--conservative", action="store_true", help="only those that promise the tolerance")
    parser.add_argument("--tolerance", type=float, default=1.0, help="of methods, pixels")
    given = parser.parse_args()
    size = tuple(int(n) for n in given.size.split("x"))
    device = open_device()
    print(f"{device.adapter.name}, {given.size}")
    if given.methods:
        for name in given.set or SETS:
            terrain = prepare([str(given.data / SETS[name])])
            for kind, view in views(terrain, size, given.view):
                print(
                    f"{name}, {kind}: {compared(drawn(terrain, view, device, given.tolerance, given.conservative))}",
                    flush=True,
                )
        return
    print(f"{'':14}{'':10}{'mean':>7}{'95 %':>7}{'largest':>9}{'ground in one':>15}")
    worst = [0.0, 0.0]
    for name in given.set or SETS:
        terrain = prepare([str(given.data / SETS[name])])
        for kind, view in views(terrain, size, given.view):
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
