"""``orograph.difference``: how much higher one DEM is than another of the same place."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from orograph._named import answering
from orograph.cards import Row, extent_rows, one_line
from orograph.dem.aligned import Aligned, shared
from orograph.dem.resample import METHODS
from orograph.dem.target import ground_spacing
from orograph.dem.undulation import DIRECTIONS, Direction, check_request
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of, temporary
from orograph.geo.grid import Grid
from orograph.geo.vertical import ELLIPSOIDAL, known_datum
from orograph.lighting.api import Map
from orograph.lighting.context import MEMORY
from orograph.lighting.raster import Band
from orograph.measuring.detection import Doubt, check_doubt
from orograph.measuring.differing import ENDS, Statistics, differ
from orograph.measuring.text import cubic, square
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.several import Numbers, numbers
from orograph.store.given import OF_AREAS, check_apart, check_names, files_of, source_of, source_of_terrain
from orograph.store.memory import MemoryTerrain
from orograph.store.source import HeightSource
from orograph.store.stored import StoredTerrain
from orograph.store.terrain import Terrain
from orograph.verbs.units import of_each, warn_of_units

if TYPE_CHECKING:
    import xarray as xr

    from orograph.rendering.picture import Picture

QUANTILES = (0.05, 0.25, 0.75, 0.95)
SIDE, LEGEND = 1000, 280
"""Pixels along the longer side of the ground in a picture, and of the furniture beside it."""
COLORS = "RdBu"
TIFF = (".tif", ".tiff")

Onto = Literal["first", "second", "finer"]


@dataclass(frozen=True, slots=True, repr=False)
class Difference:
    """How much higher the first of two terrains is than the second.

    Attributes:
        values: (rows, cols) float32, metres, NaN where one of them has no height.
        grid: their grid, a part of one of the two grids.
        statistics: their statistics. first, second: their names.
        attribution: the credit that the makers of both ask for.
    """

    values: NDArray[np.float32]
    grid: Grid
    statistics: Statistics
    first: str
    second: str
    attribution: tuple[str, ...]
    _ground: Aligned = field(repr=False)
    _terrain: Terrain | None = field(repr=False)
    _doubt: Doubt | None = field(repr=False, default=None)

    @property
    def name(self) -> str:
        return f"{self.first} minus {self.second}"

    @property
    def significance(self) -> NDArray[np.float32] | None:
        """(rows, cols) the difference over its standard deviation; None without an uncertainty."""
        if self._doubt is None:
            return None
        rows, cols = self.grid.shape
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.values / self._doubt.sigma((0, rows, 0, cols)), np.float32)

    @property
    def limit(self) -> float:
        """A round number of metres that covers at least 98 % of the differences, of those that a picture shows."""
        shown = self._shown()
        ends = self.statistics.ends if shown is None or np.isnan(shown).all() else np.nanquantile(shown, ENDS)
        largest = float(max(map(abs, ends)))
        if not 0 < largest < math.inf:
            return 1.0
        step = 10.0 ** math.floor(math.log10(largest))
        return float(f"{next(k for k in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if k * step >= largest * (1 - 1e-6)) * step:g}")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype, copy=copy)

    def to_xarray(self) -> xr.DataArray:
        """A DataArray (y, x), metres."""
        return self._map().to_xarray()

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw the difference on matplotlib's axes, in colours that are white at 0: as ``Map.plot``."""
        return self._map().plot(ax, **{"cmap": COLORS, "vmin": -self.limit, "vmax": self.limit, **options})

    def render(
        self, view: Any = "plan", *, limit: float | None = None, progress: Progress | bool | None = None, **options: Any
    ) -> Picture:
        """Draw the difference on the relief of the first terrain, with a legend: red where that is lower, blue where it
        is higher. If heights are uncertain, only what is significant is coloured.

        Args:
            view: as for ``orograph.render``; "plan": a map. limit: metres at both ends of the scale, which is centred
                on 0; None: ``self.limit``. progress: as everywhere. options: others of ``orograph.render``.

        Raises: as ``orograph.render``.
        """
        from orograph.geovis.data.dataset import Dataset
        from orograph.rendering.api import render

        if limit is not None and not 0 < limit < math.inf:
            raise UsageError(f"`limit` must be a number of metres above 0, not {limit:g}.")
        end = self.limit if limit is None else float(limit)
        heard = reporting(progress)
        with temporary() as folder:
            file = Path(folder) / "difference.tif"
            shown, name = self._shown(), "Significant change"
            if shown is None:
                shown, name = self.values, "Difference"
            elif np.isnan(shown).all():
                heard.warn("No difference is significant: nothing is coloured.")
            Map(shown[None], self.grid, self._map().bands[:1]).save(file)
            data = Dataset(file, colormap=COLORS, range=(-end, end), style="continuous", unit="m", name=name)
            how = {"size": self._size(), "furniture": True, "title": self.name.replace("_", " "), **options}
            picture: Picture = render(self._relief(heard, options), view, data=[data], progress=heard, **how)
            return picture

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it: .tif, a Cloud Optimized GeoTIFF in metres; .png, .jpg or .webp, the picture of ``render``.

        Raises:
            UsageError: another ending. OutputError: the file cannot be written.
        """
        out = Path(path)
        check_output(out)
        if out.suffix.lower() in TIFF:
            self._map().save(out)
        else:
            self.render().save(out)
        return out

    def __repr__(self) -> str:
        return one_line("Difference", self.name, [*extent_rows(self.grid), *self.rows()])

    def rows(self) -> list[Row]:
        """Its statistics in words."""
        s = self.statistics
        if not s.count:
            return [("compared", "nothing: no sample is in both")]
        found = s.detected
        errors = ("", "", "") if found is None else tuple(
            f" ± {v:,.1f} m³" for v in (found.gain_error, found.loss_error, found.net_error)
        )  # fmt: skip
        every = ", ".join(f"{100 * q:g} %: {value:+.3g}" for q, value in s.quantiles)
        return [
            ("compared", f"{s.count:,} samples, {square(s.area)}" + (f"; {s.missing:,} missing" if s.missing else "")),
            ("mean", f"mean {s.mean:+.4g} m, median {s.median:+.4g} m"),
            ("spread", f"rms {s.rms:.4g} m, NMAD {s.nmad:.4g} m"),
            ("range", f"{s.low:+.4g} to {s.high:+.4g} m" + (f" ({every})" if every else "")),
            *self._detection_text(),
            ("gain", f"gain {cubic(s.gain)}{errors[0]} on {square(s.gain_area)}"),
            ("loss", f"loss {cubic(s.loss)}{errors[1]} on {square(s.loss_area)}"),
            ("net", f"net {'+' if s.net > 0 else ''}{cubic(s.net)}{errors[2]}"),
        ]  # fmt: skip

    def _shown(self) -> NDArray[np.float32] | None:
        """What is significant, NaN elsewhere; None without an uncertainty."""
        if self._doubt is None or (sure := self.significance) is None:
            return None
        return np.where(np.abs(sure) > self._doubt.times, self.values, np.float32(np.nan))

    def _detection_text(self) -> list[Row]:
        found, s = self.statistics.detected, self.statistics
        if found is None:
            return []
        level = f"{found.lowest:.3g} m" + (f" to {found.highest:.3g} m" if found.highest > found.lowest else "")
        sure = (
            f"significant at {100 * found.confidence:g} %: beyond ± {level}, {found.count / s.count:.1%} of the samples"
        )
        whole = f"of all: gain {cubic(found.whole_gain)}, loss {cubic(found.whole_loss)}"
        return [("significant", f"{sure}; volumes are of these ({whole})")]

    def _map(self) -> Map:
        """The difference, and its significance if heights are uncertain."""
        doc = f"height of {self.first} above {self.second}, metres"
        bands, values = [Band("difference", "m", doc)], [self.values]
        if self._doubt is not None and (sure := self.significance) is not None:
            limit = f"significant at {100 * self._doubt.confidence:g} % beyond ± {self._doubt.times:.3f}"
            bands.append(Band("significance", "1", f"difference over its standard deviation; {limit}"))
            values.append(sure)
        return Map(np.stack(values), self.grid, tuple(bands))

    def _size(self) -> tuple[int, int]:
        (across, down), (rows, cols) = self.grid.spacing, self.grid.shape
        wide, tall = across * cols, down * rows
        scale = SIDE / max(wide, tall)
        return max(640, round(wide * scale) + LEGEND), max(480, round(tall * scale))

    def _relief(self, progress: Progress, options: dict[str, Any]) -> Terrain:
        """The terrain to draw it on."""
        from orograph.dem.mosaic import Mosaic
        from orograph.store.prepare import of_mosaic

        if self._terrain is not None:
            return self._terrain
        how = {k: options[k] for k in ("jobs", "max_memory") if options.get(k) is not None}
        return of_mosaic(Mosaic([self._ground]), progress=progress, **how)


@answering
def difference(
    a: Any, b: Any, output: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None, *,
    onto: Onto = "first", resampling: str = "bilinear", quantiles: Numbers = QUANTILES, limit: float | None = None,
    sigma: Any = None, range: float = 0.0, confidence: float = 0.95, any_vertical: bool = False,
    to_vertical: Direction | None = None, geoid: str | os.PathLike[str] | None = None,
    max_memory: Amount = MEMORY, jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> Difference:  # fmt: skip
    """The difference of two DEMs of one place, a − b: after and before, a surface and the ground, two products.

    The difference is taken where both have heights, at the samples of one of them. The other is interpolated there, for
    files directly from their own samples, averaged first if the grid is coarser. Any size works: it is read in blocks.

    Args:
        a, b: each whatever ``orograph.terrain`` takes. Where a is higher, the difference is positive: a gain.
        output: the file or files to write: .tif, the difference in metres; .png, .jpg, .webp, a picture of it.
        onto: whose samples are kept: the "first", the "second", or the "finer" of the two.
        resampling: of the other: "nearest", "bilinear" or "cubic".
        quantiles: which of the difference are computed, 0 to 1.
        limit: of a picture, metres at both ends of the colours; None: a round number that 98 % lie within.
        sigma: standard deviation of the heights of both, metres, or a raster of them (a file, an array over the
            result); or a pair, of a and of b. Differences within the level of detection are then not significant:
            volumes are without them and get an error, pictures do not show them, and a .tif has a second band, the
            difference over its standard deviation.
        range: metres at which 5 % of the correlation of errors is left (``orograph.measure.HeightError``); 0: errors of
            samples are independent.
        confidence: of the level of detection and of the volumes' errors, 0 to 1.
        any_vertical: accept heights above different vertical datums as they are; otherwise they are refused.
        to_vertical: "ellipsoidal" or "orthometric": convert heights that are not so yet. geoid: by this grid (a file).
        max_memory: bytes that heights may take. jobs: threads. Neither changes the difference.
        progress: gets progress reports and warnings; False: silent.
        reading: options of ``orograph.terrain``, of both: ``bbox``, ``clip``, ``crs``, ``nodata``… Stores and terrains
            take only an area. ``vertical_unit`` may name two units: of a and of b, "ft,m". If the two need other
            options that differ, read them first with ``orograph.read``.

    Returns:
        a ``Difference``: ``values``, ``grid``, ``statistics`` (mean, median, rms, NMAD, quantiles, volumes);
        ``plot(ax)``, ``render()``, ``save(path)``, ``to_xarray()``.

    Raises:
        UsageError: they do not overlap, have different vertical datums, or an option makes no sense.
        ReadError, StoreError: one cannot be read. OutputError: a file cannot be written.
    """
    heard, memory = reporting(progress), bytes_of(max_memory) or MEMORY
    files = [output] if isinstance(output, str | os.PathLike) else list(output or ())
    outputs = [Path(one) for one in files]
    for out in outputs:
        check_output(out)
        check_folder(out)
        check_apart(out, a, b)
    wanted = numbers(quantiles, "quantiles")
    if not all(0 <= q <= 1 for q in wanted):
        raise UsageError(f"`quantiles` must be numbers from 0 to 1, not {quantiles!r}.")
    if onto not in get_args(Onto):
        raise UsageError(f"`onto` must be one of {', '.join(get_args(Onto))}, not {onto!r}.")
    if resampling not in METHODS:
        raise UsageError(f"The resampling must be one of {', '.join(METHODS)}, not {resampling!r}.")
    check_doubt(sigma, range, confidence)
    check_names(reading, "difference")
    check_request(to_vertical, geoid)
    said = {**reading, "to_vertical": to_vertical, "geoid": geoid}
    if resampling != "bilinear":
        said["resampling"] = resampling
    for_a, for_b = of_each(said)
    first, second = _read(a, for_a, heard, _is_built(b)), _read(b, for_b, heard, _is_built(a))
    _check_datums(first, second, any_vertical, heard)
    finer = float(f"{ground_spacing(second.grid):.4g}") < float(f"{ground_spacing(first.grid):.4g}")
    keeps, other = (second, first) if onto == "second" or (onto == "finer" and finer) else (first, second)
    window = shared(keeps.grid, other, keeps.name)
    whole = window == (0, keeps.grid.rows, 0, keeps.grid.cols)
    one, two = (Aligned(each, keeps.grid, window, resampling) for each in (first, second))
    doubt = None if sigma is None else Doubt(one.grid, sigma, range, confidence)
    values, told = differ(one, two, wanted, max_memory=memory, jobs=jobs, progress=heard, doubt=doubt)
    warn_of_units(told.ratio, first.name, second.name, heard)
    named = dict.fromkeys((*one.attribution, *two.attribution))
    terrain = _terrain_of(a) if whole and keeps is first else None
    made = Difference(values, one.grid, told, first.name, second.name, tuple(named), one, terrain, doubt)
    for out in outputs:
        if out.suffix.lower() in TIFF:
            made.save(out)
        else:
            made.render(limit=limit, max_memory=memory, jobs=jobs, progress=heard).save(out)
    return made


def check_output(path: Path) -> None:
    """Raise UsageError unless a difference can be written to such a file."""
    from orograph.rendering.picture import FORMATS

    if path.suffix.lower() not in FORMATS:
        raise UsageError(
            f"A difference cannot be written as {path.suffix or 'a file without ending'}.", path=path,
            remedy="Use .tif for metres, .png, .jpg or .webp for a picture.",
        )  # fmt: skip


def _is_built(given: Any) -> bool:
    """Whether it is a terrain or a store, which know how they were read."""
    from orograph.store.detect import is_store

    files = files_of(given)
    return isinstance(given, Terrain) or (files is not None and len(files) == 1 and is_store(files[0]))


def _read(given: Any, said: Mapping[str, Any], progress: Progress, other_is_built: bool) -> HeightSource:
    """The reader of one of the two, window by window; no store is built for it."""
    from orograph.store.stored import open as open_store

    if _is_built(given):
        if not isinstance(given, Terrain):
            given = open_store(str((files_of(given) or [])[0]))
        assert isinstance(given, MemoryTerrain | StoredTerrain)
        # (Options about files apply to the other one if that is a file.)
        own = dict(said) if other_is_built else {name: said[name] for name in OF_AREAS if name in said}
        if said.get("to_vertical") is not None and not _is_so(given.vertical, said["to_vertical"]):
            raise UsageError(
                f"The heights of {given.name} cannot be converted, since it is already a terrain.",
                remedy="Give the files that it was made from.",
            )
        own = {name: value for name, value in own.items() if name not in ("to_vertical", "geoid")}
        return source_of(given, progress, called="difference", **own) if any(own.values()) else source_of_terrain(given)
    plain = {name: value for name, value in said.items() if name not in ("to_vertical", "geoid")}
    found = source_of(given, progress, called="difference", **plain)
    if said.get("to_vertical") is not None and not _is_so(found.vertical, said["to_vertical"]):
        found = source_of(given, progress, called="difference", **said)
    for text in getattr(found, "warnings", ()):
        progress.warn(f"{found.name}: {text}")
    return found


def _is_so(vertical: str | None, to: Direction) -> bool:
    """Whether heights are already ellipsoidal, or orthometric."""
    if vertical is None:
        return False
    return (known_datum(vertical) == ELLIPSOIDAL) == (to == "ellipsoidal")


def _check_datums(first: HeightSource, second: HeightSource, any_vertical: bool, progress: Progress) -> None:
    """Raise UsageError if the heights have different datums; warn if a datum is unknown."""
    datums = [None if one.vertical is None else known_datum(one.vertical) for one in (first, second)]
    if None in datums:
        if datums[0] is not datums[1]:
            silent, other = (first, second) if datums[0] is None else (second, first)
            progress.warn(
                f"{silent.name} does not say above which datum its heights are; they are taken to be above that of "
                f"{other.name}, {other.vertical}."
            )
        return
    if datums[0] == datums[1] or any_vertical:
        return
    raise UsageError(
        f"The heights of {first.name} are above {first.vertical}, those of {second.name} above {second.vertical}, so "
        "their difference is not a difference of the ground.",
        remedy=f"Convert them with `to_vertical={DIRECTIONS[0]!r}` and a `geoid`, or take them as they are with "
        "`any_vertical`.",
    )


def _terrain_of(given: Any) -> Terrain | None:
    """The terrain that was given, if it is a terrain or a store."""
    from orograph.store.stored import open as open_store

    if isinstance(given, Terrain):
        return given
    return open_store(str((files_of(given) or [])[0])) if _is_built(given) else None
