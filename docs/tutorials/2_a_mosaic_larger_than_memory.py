"""
A mosaic larger than memory
===========================

Tiles become a store: one terrain at all resolutions. A picture reads only the parts it needs.
"""

# %%
# These four tiles share no samples, as an agency might deliver them. (They are small, so that this page runs in a
# moment; the code is the same for ten thousand.)

from pathlib import Path
from tempfile import mkdtemp

import rasterio
from rasterio.windows import Window

import orograph


def cut(path: Path, row: int, col: int) -> Path:
    """A tile of a raster, as a file of its own."""
    with rasterio.open(path) as file:
        window = Window(col, row, min(513, file.width - col), min(513, file.height - row))
        profile = {**file.profile, "width": window.width, "height": window.height}
        tile = path.with_name(f"{row}_{col}.tif")
        with rasterio.open(tile, "w", **{**profile, "transform": file.window_transform(window)}) as out:
            out.write(file.read(window=window))
    return tile


folder = Path(mkdtemp())
whole = orograph.synth(folder / "whole.tif", size=1025, seed=4, progress=False)
tiles = [cut(whole, row, col) for row in (0, 513) for col in (0, 513)]

# %%
# ``build`` reads each tile once, within the memory that it is allowed. An interrupted build continues with
# ``resume=True``; ``check`` reads every byte of a store and reports any damage.

store = orograph.build(tiles, folder / "area.oro", max_memory=256 << 20, progress=False)
assert orograph.check(store.url, progress=False) == []
orograph.info(store.url)

# %%
# Pictures, measurements and light read the store tile by tile.

terrain = orograph.open(folder / "area.oro")
picture = orograph.render(terrain, size=(960, 540), sky=True)

# %%
# The way between two places, along the ground:

x, y = terrain.grid.xy([100, 900], [150, 800])
profile = orograph.measure.profile(terrain, list(zip(x, y)))
print(f"{profile.length / 1000:.1f} km on foot, {profile.climb:.0f} m up, {profile.descent:.0f} m down")
