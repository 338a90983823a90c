"""Colours over the ground by example: an orthophoto and the ground it shows determine the look of other ground.

Coordinates are chosen as for detail by example (``steered``): places begin where slopes and curvature match the
example's ground, and are corrected by the photo around them, represented by its first principal component (as in S.
Lefebvre, H. Hoppe, *Parallel controllable texture synthesis*, 2005). A place gets the colour at its coordinate. Any
window is the same to the bit wherever it begins.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.progress import SILENT, Progress
from orograph.store.given import source_of
from orograph.store.opening import terrain as opened
from orograph.store.source import HeightSource
from orograph.synthesis.exemplar import Exemplar
from orograph.synthesis.reference import folded
from orograph.synthesis.refining import MISSING, Data, Floats, Integers, Lattice
from orograph.synthesis.steered import Guide, Steering
from orograph.synthesis.terrain import example
from orograph.synthesis.windows import Range

BEGIN = 3
"""Minimum doublings from the first places of colours to the finest: more give larger pieces, which fit the ground less
well."""

LIKE = 2
"""Weight of the ground, relative to its weight for detail."""


class Every:
    """A lattice of every n-th sample."""

    def __init__(self, lattice: Lattice, step: int) -> None:
        self.lattice, self.step, self.quantum = lattice, step, lattice.quantum

    def read(self, r: Range) -> Integers:
        """See ``refining.Lattice``."""
        s = self.step
        wide = Range(r.row0 * s, (r.row1 - 1) * s + 1, r.col0 * s, (r.col1 - 1) * s + 1)
        return self.lattice.read(wide)[::s, ::s]


class ByAspect(Steering):
    """Steering by slopes as they are, in mirror images of the example too.

    A photo has its light from one side, and vegetation depends on the aspect of a slope.
    """

    def _guide(self, shape: tuple[Floats, Floats, Floats]) -> Guide:
        known = np.clip(LIKE * super()._guide(shape).astype(np.int32), -1023, 1023).astype(np.int16)
        # (Otherwise the first two would change their signs.)
        return np.concatenate([np.zeros((*known.shape[:2], 2), np.int16), known], -1)


class ColoursByExample:
    """Colours for a terrain, read by windows: (rows, cols, 4) uint8, red, green, blue, and 0 where there is no ground.

    Args:
        photo: an image of the example with at least three bands. ground: its heights, whatever ``orograph.terrain``
            takes, at most ``exemplar.MOST`` samples, none missing.
        over: the terrain to colour, whatever ``orograph.terrain`` takes.
        seed: a different number gives different colours. jobs: threads. progress: gets the progress of the preparation.

    Attributes:
        grid: where pixels lie: about as far apart as the samples of the example's ground, at samples of ``over``.

    Raises:
        UsageError: the example is no good, or the photo does not cover its ground. ReadError: something cannot be read.
    """

    bands = 4

    def __init__(
        self, photo: Any, ground: Any, over: Any, seed: int = 1, *, jobs: int | None = None,
        progress: Progress = SILENT,
    ) -> None:  # fmt: skip
        source = source_of(ground, progress, called="synth")
        heights, self.colours = example(source).astype(np.float64), _photo_over(photo, source)
        shade = _component(self.colours, str(photo))
        exemplar = Exemplar.of(shade, str(photo), jobs, progress, relative=False)
        terrain = opened(over, progress=progress)
        apart, own = max(terrain.grid.spacing), max(source.grid.spacing)
        finer = round(math.log2(apart / own))
        doublings = min(exemplar.top, max(finer, BEGIN))
        every = max(doublings - finer, 0)
        finer = doublings - every
        self._finer, self._data = finer, Data(terrain)
        data: Lattice = Every(self._data, 1 << every) if every else self._data
        self.steering = ByAspect(exemplar, data, doublings, apart * 2.0**-finer / own, seed, heights)
        self.grid = _grid(terrain.grid, finer)
        self.name = f"after {source.name} {seed}"
        self.attribution: tuple[str, ...] = tuple(getattr(source, "attribution", ()))

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.uint8]:
        """A half-open window. Safe from any thread."""
        r, s = Range(row0, row1, col0, col1), self.steering
        chosen = s.coordinates(s.doublings, r).astype(np.int64)
        rows, cols = self.colours.shape[:2]
        out = np.empty((*r.shape, 4), np.uint8)
        out[..., :3] = self.colours[folded(chosen[..., 1], rows), folded(chosen[..., 0], cols)]
        row, col = (np.floor(np.arange(*ends) * 2.0**-self._finer + 0.5).astype(int) for ends in (r[:2], r[2:]))
        own = Range(int(row[0]), int(row[-1]) + 1, int(col[0]), int(col[-1]) + 1)
        there = self._data.read(own) != MISSING
        out[..., 3] = np.where(there[np.ix_(row - own.row0, col - own.col0)], 255, 0)
        return out


def _grid(grid: Grid, finer: int) -> Grid:
    """A grid whose samples are 2^``finer`` times as close, beginning at the same one."""
    scale = 2.0**-finer
    own = Affine.translation(0.5, 0.5) @ Affine.scale(scale) @ Affine.translation(-0.5, -0.5)
    rows, cols = (math.floor((n - 1) / scale) + 1 for n in grid.shape)
    return Grid((rows, cols), grid.transform @ own, grid.crs)


def _photo_over(photo: Any, source: HeightSource) -> NDArray[np.uint8]:
    """The photo's colours (rows, cols, 3) at the samples of its ground.

    Raises:
        ReadError: it cannot be read. UsageError: it is not a colour image, or does not cover the ground.
    """
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    grid = source.grid
    try:
        with rasterio.open(photo) as file:
            if file.count < 3 or file.dtypes[0] != "uint8":
                raise UsageError(
                    f"A photo must have three bands of bytes; this one has {file.count} of {file.dtypes[0]}.",
                    path=str(photo),
                )
            crs = file.crs if grid.crs is None else grid.crs.to_wkt()
            with WarpedVRT(
                file, crs=crs, transform=grid.transform, height=grid.rows, width=grid.cols, add_alpha=True,
                resampling=Resampling.bilinear,
            ) as laid:  # fmt: skip
                bands: NDArray[np.uint8] = laid.read([1, 2, 3])
                covered = laid.dataset_mask() != 0
    except rasterio.errors.RasterioError as error:
        raise ReadError(f"The photo cannot be read: {error}", path=str(photo)) from error
    if not covered.all():
        raise UsageError(
            f"The photo covers {covered.mean():.1%} of the example's ground.", path=str(photo),
            remedy="Give the heights of the area it shows (cut them with gdal_translate -projwin).",
        )  # fmt: skip
    return np.ascontiguousarray(np.moveaxis(bands, 0, -1))


def _component(colours: NDArray[np.uint8], name: str) -> NDArray[np.float64]:
    """The first principal component of colours (rows, cols).

    Raises:
        UsageError: they are all the same.
    """
    flat = colours.reshape(-1, 3).astype(np.float64)
    flat -= flat.mean(0)
    if not flat.any():
        raise UsageError("A photo of a single colour cannot serve as an example.", path=name, remedy="Take another.")
    # The sign of an eigenvector is arbitrary, and does not affect distances.
    _, axes = np.linalg.eigh(flat.T @ flat)
    return np.asarray(np.rint(64 * (flat @ axes[:, -1])).reshape(colours.shape[:2]) / 64)
