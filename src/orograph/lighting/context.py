"""The context of light products: terrain, options, threads, memory, progress, and swept horizons.

Results do not depend on blocks, threads or memory, to the bit.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from numbers import Real
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph._named import check_simple, named, simple
from orograph.errors import UsageError
from orograph.parallel import map_ordered, threads_for
from orograph.progress import SILENT, Progress
from orograph.several import Numbers, numbers
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Heights, Terrain

if TYPE_CHECKING:
    from pyproj import CRS

    from orograph.lighting.raster import Canvas
    from orograph.lighting.raster_resume import Checkpoint
    from orograph.lighting.sweep import Block
    from orograph.lighting.sweep_pass import Terms

Values = NDArray[np.float32]
Blocks = Iterator[tuple[int, int, Values]]

MORE = {
    "rho": "Rho", "method": "str", "seed": "int", "cones": "int", "strips": "int", "diameter": "float", "date": "str",
    "step": "float", "turbidity": "float",
}  # fmt: skip
"""Options of single products, with their types."""

REFRACTION = 0.13
"""Usual coefficient of refraction over the Earth's ground in surveying (Gauss)."""

_EARTH = 6378137.0

MEMORY = 1 << 30
BASE = 320 << 20
"""Bytes of the interpreter, its libraries, compiled kernels and a store's cache."""
_PIECE = 1024
"""Columns read at a time if the same tiles are read repeatedly."""


def _number(value: Any, above: float = -math.inf) -> bool:
    """Whether something is a finite number greater than ``above``."""
    return isinstance(value, Real) and math.isfinite(value) and float(value) > above


def weighted(lights: Iterable[Numbers]) -> tuple[tuple[float, ...], ...]:
    """Several lights as (azimuth, altitude, weight); the weight may be left out, and is then 1."""
    given = [numbers(light, "lights") for light in lights]
    return tuple((*light, 1.0) if len(light) == 2 else light for light in given)


@named("A product of light")
@dataclass(frozen=True, slots=True)
class Options:
    """Options of products; each uses those that apply to it.

    Attributes:
        azimuths: how many directions horizons are swept in, evenly spread, the first in the north.
        sun: (azimuth, altitude) of the light, degrees.
        lights: several of them as (azimuth, altitude[, weight]), for hillshade; () for ``sun`` alone.
        radius: metres beyond which nothing occludes; None: unlimited.
        curvature: whether horizons take the curvature of the Earth (or the CRS's body) and refraction into account.
        refraction: coefficient k of terrestrial refraction: rays bend by k times the body's curvature. None: 0.13 on
            the Earth, 0 on bodies with little or no air.
        exaggeration: heights are multiplied by this for hillshade only.
        rays: per sample, for Monte Carlo products.
        more: options of single products, by name (``MORE``): ``rho``, ``method``, ``seed``, ``cones`` (ambient
            occlusion), ``strips``, ``diameter`` (shadow), ``date``, ``step`` (insolation and
            sunshine), ``turbidity`` (insolation).
    """

    azimuths: int = 32
    sun: tuple[float, float] = (315.0, 45.0)
    lights: tuple[tuple[float, ...], ...] = ()
    radius: float | None = None
    curvature: bool = False
    refraction: float | None = None
    exaggeration: float = 1.0
    rays: int = 256
    more: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, **given: Any) -> Self:
        """Options by name, including those of ``more``.

        Raises:
            UsageError: there is no such option; names like it are suggested.
        """
        known = [name for name in cls.__dataclass_fields__ if name != "more"]
        for name in given:
            if name not in known and name not in MORE:
                close = difflib.get_close_matches(name, [*known, *MORE], 2, 0.6)
                there = f"The options are {', '.join(sorted({*known, *MORE}))}."
                if name in ("azimuth", "altitude", "az", "alt", "angle_altitude", "elevation"):
                    remedy = "The sun's place is `sun=(azimuth, altitude)`, degrees: `sun=(315, 45)`."
                elif name in ("output", "path", "filename", "out"):
                    remedy = "Save the result: `orograph.light(dem, 'slope').save('slope.tif')`, or give its `output`."
                elif name in ("product", "name", "names"):
                    remedy = "Products are given first, or as `products`."
                else:
                    remedy = f"Did you mean {' or '.join(close)}?" if close else there
                raise UsageError(f"There is no option {name!r}.", remedy=remedy)
        if "lights" in given:
            given["lights"] = weighted(given["lights"])
        more = {k: v for k, v in given.items() if k in MORE}
        return cls(**{k: v for k, v in given.items() if k in known}, more=more)

    def __post_init__(self) -> None:
        check_simple(simple(MORE), self.more.items())
        if self.azimuths < 3:
            raise UsageError(f"At least three azimuths are needed, not {self.azimuths}.")
        if self.radius is not None and not _number(self.radius, above=0.0):
            raise UsageError(f"The radius must be a positive number of metres, not {self.radius!r}.")
        if not _number(self.exaggeration, above=0.0):
            raise UsageError(f"The exaggeration must be a positive number, not {self.exaggeration!r}.")
        if self.refraction is not None and (not _number(self.refraction) or abs(self.refraction) > 1.0):
            raise UsageError(
                f"The coefficient of refraction must be between -1 and 1 (usually 0.13), not {self.refraction}."
            )
        if any(len(light) != 3 or not all(map(_number, light)) for light in self.lights):
            raise UsageError("Each of several lights must be (azimuth, altitude, weight), all numbers.")
        for _, altitude, weight in self.lights:
            if abs(altitude) > 90:
                raise UsageError(f"A light's altitude must be between -90 and 90 degrees, not {altitude:g}.")
            if weight < 0:
                raise UsageError(f"Lights need positive weights, not {weight:g}.")
        if self.lights and not any(weight for *_, weight in self.lights):
            raise UsageError("Lights need weights that are not all 0.")

    def bending(self, crs: CRS | None) -> float:
        """The coefficient of refraction over a terrain of that CRS (None: on the Earth)."""
        if self.refraction is not None:
            return self.refraction
        body = None if crs is None else crs.ellipsoid
        return REFRACTION if body is None or abs(body.semi_major_metre / _EARTH - 1.0) < 0.01 else 0.0

    def directions(self) -> NDArray[np.float64]:
        """The azimuths (n,), degrees."""
        return np.arange(self.azimuths, dtype=np.float64) * (360.0 / self.azimuths)


class Context:
    """The inputs of a product.

    Args:
        terrain: in metres.
        max_memory: bytes the process should stay within.
        jobs: threads; None: all processors.
        kept: where sweeps store partial results and find them again; None: nowhere.
        only: the window (row0, row1, col0, col1) that products made window by window are made for; None: all.

    Attributes:
        shape: (rows, cols) of the terrain and of every product.
        linear: (2, 2) metres east and north per column and per row.
    """

    def __init__(
        self,
        terrain: Terrain,
        options: Options | None = None,
        *,
        jobs: int | None = None,
        max_memory: int = MEMORY,
        progress: Progress = SILENT,
        kept: Checkpoint | None = None,
        only: tuple[int, int, int, int] | None = None,
    ) -> None:
        self.kept, self.only = kept, only
        self.terrain, self.options = terrain, options or Options()
        self.jobs, self.max_memory, self.progress = threads_for(jobs), max_memory, progress
        self.shape = terrain.grid.shape
        self.linear = terrain.grid.linear
        # A terrain in memory is already counted; a store takes only its cache (part of BASE).
        self._held = 4 * self.shape[0] * self.shape[1] if isinstance(terrain, MemoryTerrain) else 0

    @property
    def budget(self) -> int:
        """Bytes available for blocks: the limit minus the process itself, its terrain and canvases in memory."""
        return max(self.max_memory - BASE - self._held, 32 << 20)

    def heights(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a window, metres, NaN where missing; read-only."""
        return self.terrain.read(0, row0, row1, col0, col1)

    def gradient(self, row0: int, row1: int, col0: int, col1: int) -> tuple[Values, Values]:
        """Rise per metre east and north of a window, the same as for the whole raster."""
        from orograph.lighting.normal import gradient

        r0, c0 = max(row0 - 1, 0), max(col0 - 1, 0)
        r1, c1 = min(row1 + 1, self.shape[0]), min(col1 + 1, self.shape[1])
        inner = np.s_[row0 - r0 : row1 - r0, col0 - c0 : col1 - c0]
        # Adjacent strips of rows need the same tiles; pieces of a few tiles come from the store's cache.
        cuts = [c0, c1]
        if not isinstance(self.terrain, MemoryTerrain):
            cuts[1:1] = range((c0 // _PIECE + 1) * _PIECE, c1, _PIECE)
        pieces = [self.heights(r0, r1, a, b) for a, b in pairwise(cuts)]
        heights = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)
        east, north = gradient(heights, self.linear, 1)
        return east[inner], north[inner]

    def canvas(self, bands: int) -> Canvas:
        """A canvas of ``bands`` bands; in memory if it takes at most half of the remaining budget."""
        from orograph.lighting.raster import Canvas

        size = 4 * bands * self.shape[0] * self.shape[1]
        on_disk = 2 * size > self.budget
        if not on_disk:
            self._held += size
        return Canvas(bands, self.shape, on_disk)

    def horizons(
        self,
        azimuths: Sequence[float] | NDArray[np.float64] | None = None,
        *,
        lowest: float = 0.0,
        below: bool = False,
        what: str = "Sweeping horizons",
        skip: Collection[int] = (),
    ) -> Iterator[Block]:
        """The horizon in each azimuth at each sample, by bands of rows or of columns (see ``sweep.horizons``).

        Args:
            azimuths: degrees; None: those of the options.
            lowest: the smallest slope (0: a level horizon; -inf: slopes may be negative).
            below: use the terrain turned upside down (for negative openness).
            skip: indices of azimuths to leave out.

        Yields:
            blocks; each sample comes once with each azimuth, its azimuths always in the same order. A block's
            ``slopes`` are reused for the next block. The radius, curvature and refraction are those of the options.
        """
        from orograph.lighting.sweep import horizons

        options, terms = self.options, self.terms(lowest, below)
        return horizons(
            self.heights,
            self.shape,
            self.linear,
            options.directions() if azimuths is None else np.asarray(azimuths, np.float64),
            **terms._asdict(),
            jobs=self.jobs,
            memory=self.budget,
            progress=self.progress,
            what=what,
            skip=skip,
        )

    def terms(self, lowest: float = 0.0, below: bool = False) -> Terms:
        """The kind of horizons, from the options."""
        from orograph.lighting.sweep import curvature_of
        from orograph.lighting.sweep_pass import Terms

        options, crs = self.options, self.terrain.grid.crs
        bend = curvature_of(crs, options.bending(crs)) if options.curvature else 0.0
        return Terms(lowest, below, options.radius, bend)

    def blocks(self, make: Callable[[int, int, int, int], Values], what: str, height: int = 256) -> Blocks:
        """Make a product window by window, in threads, window by window of whole tiles of a store.

        Args:
            make: (row0, row1, col0, col1) → (bands, rows, cols) float32.
            what: for the progress line.
        """
        from orograph.lighting.raster import rectangles

        width = max(256, (1 << 22) // height)
        windows = list(rectangles(self.shape, height, width))
        with self.progress.task(what, total=len(windows)) as task:
            made = map_ordered(lambda w: (w[0], w[2], make(*w)), windows, self.jobs)
            for block in made:
                yield block
                task.advance()
