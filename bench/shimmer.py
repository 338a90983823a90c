"""Shimmer, measured: how much more a slow flight changes from frame to frame than a finely sampled one.

    python bench/shimmer.py [--terrain NAME]… [--size 480x270] [--frames 12] [--samples 1]… [--data FOLDER]
        [--method auto]… [--tolerance 1]

The flight has a third of a pixel of parallax per frame over rough ground. Every frame f is drawn as the window does,
and with 16 samples per pixel as the reference r. Shimmer is any change from frame to frame that the reference does not
show, or the lack of one that it shows. In linear light, rms over frames and pixels:

    S = rms((f[t+1] − f[t]) − (r[t+1] − r[t])) / rms(r[t+1] − r[t]),    C = rms(f[t+1] − f[t]) / rms(r[t+1] − r[t])

C above 1 flickers. S is 0 for a picture that changes like r, and 1 for one that does not change. (16 samples against 64
have S = 0.45, which is the reference's own share.) Both are given over all pixels, over those within 12 pixels below
the horizon, and over the ground in front. The reference is always drawn by streamed patches. ``--samples n`` draws n
samples per pixel instead of what the window does in motion; 1, 4 and 8 show the results of no antialiasing and of
supersampling. 0 is the window's way: samples are gathered from frame to frame, after a lead-in of 32 frames.

Terrains: bigtujunga (30 m), *noise* (every sample 3 m up or down: detail of one sample's size), *contours* (bigtujunga
with contour lines), *imagery* (Fort Bragg with its orthophoto), *raster* (bigtujunga under a coloured raster in
degrees, with cells of one sample's size and holes without data).
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from orograph.dem.mosaic import Mosaic
from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.geovis.layers import Layer
from orograph.gpu.device import Device, open_device
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Floats = NDArray[np.float64]
Size = tuple[int, int]

TERRAINS = ("bigtujunga", "noise", "contours", "imagery", "raster")
BAND = 12
"""Pixels below the horizon that count as being at it."""
REFERENCE, LEAD = 16, 32


def noise(side: int = 1500, metres: float = 30.0) -> Terrain:
    """Long hills with every sample 3 m up or down."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:side, :side]
    z = 200 * np.sin(x / 60) * np.cos(y / 75) + 3.0 * rng.choice([-1.0, 1.0], (side, side))
    grid = Grid(z.shape, Affine(metres, 0, 500_000, 0, -metres, 5_300_000), CRS.from_epsg(32632))
    return in_memory(Dem(z.astype(np.float32), grid))


def raster(terrain: Terrain) -> Path:
    """Random values in degrees over a terrain, a quarter of them missing in squares of 1 to 8 pixels."""
    import rasterio

    west, south, east, north = terrain.grid.bounds()
    lon, lat = Transformer.from_crs(terrain.grid.crs, 4326, always_xy=True).transform([west, east], [south, north])
    rng = np.random.default_rng(7)
    rows, cols = terrain.grid.shape
    values = rng.normal(0, 1, (rows, cols)).astype(np.float32)
    for side in (1, 8):
        holes = rng.random((-(-rows // side), -(-cols // side))) < 0.125
        values[np.repeat(np.repeat(holes, side, 0), side, 1)[:rows, :cols]] = -9999
    path = Path(tempfile.mkdtemp()) / "raster.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=rows, width=cols, dtype="float32", crs="EPSG:4326", nodata=-9999,
        transform=Affine((lon[1] - lon[0]) / cols, 0, lon[0], 0, -(lat[1] - lat[0]) / rows, lat[1]), tiled=True,
    ) as file:  # fmt: skip
        file.write(values, 1)
    return path


def scene_of(name: str, data: Path) -> Scene | None:
    """A terrain and its layers; None if its files are absent."""
    files = {"noise": [], "imagery": ["fortbragg-1m-dem-ortho"]}.get(name, ["bigtujunga-srtm30m-utm"])
    if not all((data / f).is_dir() for f in files):
        return None
    if name == "noise":
        terrain = noise()
    elif name == "imagery":
        terrain = in_memory(Mosaic.open([str(next((data / files[0]).glob("elevation_2016.tif")))]))
    else:
        terrain = in_memory(Mosaic.open([str(next((data / files[0]).glob("*.tif")))]))
    view = View((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    scene = Scene.of(terrain, view, sky=True, tolerance=1.0, shadows=name != "noise")
    if name == "contours":
        return scene.but(contours=Contours(interval=40.0))
    if name == "raster":
        return scene.but(layers=(Layer(str(raster(terrain)), colormap="viridis"),))
    if name == "imagery":
        image = next(p for p in (data / files[0]).glob("*.tif") if "naip_2014" in p.name)
        return scene.but(layers=(Layer(str(image)),))
    return scene


def flight(terrain: Terrain, size: Size, count: int) -> list[View]:
    """Low over the ground, towards its far end, a little downwards; the horizon is in the upper third."""
    rows, cols = terrain.grid.shape
    x0, y0 = (float(v) for v in terrain.grid.xy(0.1 * cols, 0.5 * rows))
    x1, y1 = (float(v) for v in terrain.grid.xy(0.9 * cols, 0.45 * rows))
    length = float(np.hypot(x1 - x0, y1 - y0))
    ground = terrain.read(0, int(0.48 * rows), int(0.52 * rows) + 1, int(0.08 * cols), int(0.14 * cols) + 1)
    high = float(np.nanmax(ground)) + 0.02 * length
    ahead = np.array([(x1 - x0) / length, (y1 - y0) / length, -0.12])
    aside = np.array([-ahead[1], ahead[0], 0.0])
    eye = np.array([x0, y0, high])
    first = View(tuple(eye), tuple(eye + 0.3 * length * ahead), fov_y=45.0, width=size[0], height=size[1])
    step = 0.33 * first.pixel_slope * 0.1 * length  # a third of a pixel at a tenth of the way to the end
    moves = [k * step * (0.6 * aside + 0.8 * ahead) for k in range(LEAD + count)]
    return [
        replace(first, eye=tuple(eye + move), target=tuple(eye + move + 0.3 * length * ahead)) for move in moves
    ]  # fmt: skip


class Camera:
    """Draws frames and reads them back."""

    def __init__(self, device: Device, scene: Scene, size: Size) -> None:
        self.device, self.scene = device, scene
        self.renderer = Renderer(device, scene.terrain)
        self.texture = device.texture(size, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()

    def frames(self, views: list[View], samples: int) -> list[Floats]:
        """Linear light (height, width, 3) of each view, with so many samples per pixel; 0: as the window does."""
        found = []
        for view in views:
            scene = self.scene.but(view=view)
            if samples:
                self.renderer.draw(self.target, "rgba8unorm", scene, wait=True, samples=samples)
            else:
                self.renderer.draw(self.target, "rgba8unorm", scene)
            data = self.device.read_texture(self.texture, np.uint8, 4)[..., :3] / 255.0
            found.append(np.where(data <= 0.04045, data / 12.92, ((data + 0.055) / 1.055) ** 2.4))
        return found

    def horizon(self) -> NDArray[np.int64]:
        """For each column, the first row that shows ground in the last frame."""
        there = np.isfinite(self.renderer.depth())
        return np.where(there.any(0), there.argmax(0), there.shape[0])


def shimmer(frames: list[Floats], reference: list[Floats], mask: NDArray[np.bool_]) -> tuple[float, float]:
    """S and C over a mask of pixels."""
    changes, true = np.diff(np.stack(frames), axis=0)[:, mask], np.diff(np.stack(reference), axis=0)[:, mask]
    extra = changes - true
    base = float(np.sqrt((true**2).mean()))
    rms = [float(np.sqrt((values**2).mean())) / max(base, 1e-9) for values in (extra, changes)]
    return rms[0], rms[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--terrain", action="append", choices=TERRAINS)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--method", action="append", help="as for --method; default: auto (streamed patches)")
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--samples", type=int, action="append", help="0: as the window draws in motion (default)")
    options = parser.parse_args()
    width, height = (int(v) for v in options.size.split("x"))
    device = open_device()
    print(f"{device.adapter.name}, {width} × {height}, {options.frames} frames; S, C")
    print(f"{'':14}{'samples':>9}{'all':>18}{'at the horizon':>18}{'in front':>18}")
    for name in options.terrain or TERRAINS:
        scene = scene_of(name, options.data)
        if scene is None:
            print(f"{name}: its data are not at {options.data}")
            continue
        views = flight(scene.terrain, (width, height), options.frames)
        led, views = views, views[LEAD:]
        camera = Camera(device, scene.but(tolerance=options.tolerance), (width, height))
        reference = camera.frames(views, REFERENCE)
        top = camera.horizon()
        row = np.arange(height)[:, None]
        masks = [
            np.ones((height, width), bool), (row >= top - 2) & (row < top + BAND), row >= top + BAND,
        ]  # fmt: skip
        for method, samples in itertools.product(options.method or ["auto"], options.samples or [0]):
            camera.scene = camera.scene.but(method=method)
            frames = camera.frames(views if samples else led, samples)[-len(views) :]
            cells = ["{:.2f}, {:.2f}".format(*shimmer(frames, reference, mask)) for mask in masks]
            label = name if method == "auto" else f"{name}, {method}"
            print(f"{label:14}{samples or 'window':>9}" + "".join(f"{cell:>18}" for cell in cells), flush=True)
        camera.renderer.close()


if __name__ == "__main__":
    main()
