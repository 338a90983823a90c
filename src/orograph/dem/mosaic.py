"""Many rasters as one terrain: any files, any CRS, any spacing, read by windows of one projected metric grid.

Sources on one lattice are first put together sample by sample (``lattice``), so that tiles which share an edge,
overlap or merely touch have no seam. The finest lattice decides the grid (``target``); where it has no value the next
coarser fills in. A lattice that *is* the target grid is copied; any other is resampled straight from its files to the
target, window by window: exact projection on a sparse mesh (``coordinates``), then the kernels of ``resample``, after
averaging blocks of samples where the target is coarser. Nothing depends on how the raster is cut into windows or on
who reads them: results are the same to the bit. Units: metres; samples.
"""

from __future__ import annotations

import hashlib
import inspect
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph.dem.area import Area, recorded
from orograph.dem.deciding import files_of, states
from orograph.dem.lattice import Lattice, Raster, SourceLattice, group
from orograph.dem.layers import filled, layer_of, reaches
from orograph.dem.placing import placed, scale_at_centre, scales, turned
from orograph.dem.points import heights_at
from orograph.dem.resample import METHODS
from orograph.dem.target import choose, ground_spacing, parse_crs
from orograph.dem.undulation import ConvertedLattice, Direction, Undulation, check_datums, check_request, latitudes_of
from orograph.dem.void import check_void, void_of, void_warning
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geo.operations import approximation, same_body
from orograph.geo.vertical import Geoid
from orograph.progress import SILENT, Progress

if TYPE_CHECKING:
    from orograph.dem.manifest import Line

UNEVEN = 1.1  # ratio of scales within a kept projection that is also worth a warning
FALSE_SCALE = 0.01  # scale error of a kept projection that is worth a warning

Heights = NDArray[np.float32]


class Mosaic:
    """One raster made from many.

    Attributes:
        grid: the terrain's grid: projected, metres (or local metres without a CRS).
        name: the file's stem, or that of the first and how many more.
        vertical: name of the vertical datum, None if unknown or mixed.
        warnings: what a user should know, full sentences.
        sources: the rasters, in order of precedence within a lattice.
        projection: why the grid has its CRS ("UTM zone 11N", "as the source").
        lossless: whether every sample is a source's own, none interpolated.
        resampling: "nearest", "bilinear" or "cubic".
        void: lower bound of the part of the grid outside all sources, 0 to 1.
        undulation: the requested conversion of heights, or None.
        attribution: the credits that the sources' makers ask for, each once.
        dtypes: the stored types of the sources, e.g. ("int16",).
        skipped: files that could not be opened and were left out, each with its cause.
        named: the names that it was opened by, if manifests were among them.
        reading: the options of ``Source.open`` that its files were opened with.
    """

    skipped: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    reading: Mapping[str, Any] = MappingProxyType({})

    def __init__(
        self,
        sources: Sequence[Raster],
        *,
        crs: str | CRS | None = None,
        resolution: float | None = None,
        resampling: str = "bilinear",
        to_vertical: Direction | None = None,
        geoid: Geoid | str | os.PathLike[str] | None = None,
        bbox: Sequence[float] | str | None = None,
        clip: Any = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        if resampling not in METHODS:
            raise UsageError(f"The resampling must be one of {', '.join(METHODS)}, not {resampling!r}.")
        if not sources:
            raise UsageError("There is no file to read.")
        check_request(to_vertical, geoid)
        wanted = None if crs is None else parse_crs(crs)
        area = Area.of(bbox, clip)
        self.sources: tuple[Raster, ...] = tuple(sources if area is None else area.cut(sources))
        self.resampling = resampling
        self.warnings: list[str] = []
        grids = turned([placed(s, options or {}, self.warnings) for s in self.sources])
        if len({g.crs is None for g in grids}) == 2:
            nameless = next(s for s, g in zip(self.sources, grids) if g.crs is None)
            raise ReadError(
                "It has no CRS while other files have one: they cannot be combined.",
                path=getattr(nameless, "path", nameless.name),
                remedy="Give the CRS of such files with `assume_crs`.",
            )
        if wanted is not None and grids[0].crs is None:
            raise UsageError(
                "It has no CRS, so it cannot be transformed to another.",
                path=getattr(self.sources[0], "path", self.sources[0].name),
                remedy="Give its CRS (`assume_crs`), or write one into it (gdal_edit.py -a_srs).",
            )
        self._check_bodies(grids, wanted)
        lattices = sorted(group(self.sources, grids), key=lambda g: float(f"{ground_spacing(g.grid):.4g}"))
        target = choose(lattices, crs=wanted, resolution=resolution)
        self.grid = target.grid
        self.projection = target.reason
        self._layers = [layer_of(lattice, target.grid, resampling) for lattice in lattices]
        self.void = void_of(lattices, target.grid)
        self.lossless = all(layer.offset is not None for layer in self._layers)
        others = f" and {len(self.sources) - 1} more" if len(self.sources) > 1 else ""
        self.name = self.sources[0].name + others
        self.dtypes = tuple(sorted({str(getattr(s, "dtype", "float32")) for s in self.sources}))
        self.attribution = tuple(dict.fromkeys(a for s in self.sources for a in getattr(s, "attribution", ())))
        self.vertical = self._one_datum()
        self.undulation: Undulation | None = None
        self._own = self._layers
        if to_vertical is not None and geoid is not None:
            grid = geoid if isinstance(geoid, Geoid) else Geoid.open(geoid, latitudes=latitudes_of(lattices))
            check_datums(self.sources, to_vertical, grid)
            self.undulation = Undulation(grid, to_vertical, self.grid, lattices)
            self.vertical = self.undulation.vertical
            self._own = [
                replace(layer, lattice=ConvertedLattice(lattice, grid, to_vertical))
                for layer, lattice in zip(self._layers, lattices)
            ]
        self._options = {
            "crs": None if wanted is None else wanted.to_wkt(),
            "resolution": resolution,
            "to_vertical": to_vertical,
            **({} if area is None else {"bbox": area.box, "clip": recorded(clip)}),
            **(options or {}),
        }
        self._gather_warnings()
        self._warn_of_datums(lattices)

    @classmethod
    def open(
        cls,
        paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str] | Line],
        *,
        crs: str | CRS | None = None,
        resolution: float | None = None,
        resampling: str = "bilinear",
        to_vertical: Direction | None = None,
        geoid: Geoid | str | os.PathLike[str] | None = None,
        bbox: Sequence[float] | str | None = None,
        clip: Any = None,
        skip_damaged: bool = False,
        progress: Progress = SILENT,
        **options: Any,
    ) -> Mosaic:
        """Open files (headers only) and choose the grid that holds them all.

        Args:
            paths: one file or many, folders of them (``dem.folders``), or manifests or lines of them
                (``dem.manifest``); where several on one lattice have a sample, the first given wins.
            crs: projected CRS of the terrain; one in feet is used with metre axes.
            resolution: metres between samples of the terrain.
            resampling: "nearest", "bilinear" or "cubic"; has no effect if samples are kept.
            to_vertical: "ellipsoidal" or "orthometric": convert heights to those above the ellipsoid, or the geoid.
            geoid: the geoid grid, or its file, by which to convert.
            bbox: west, south, east, north in degrees: read this area only.
            clip: polygons outside which samples are missing (``Area.of``).
            skip_damaged: leave out files that cannot be opened (``skipped`` and a warning name them): their ground is
                missing. Damage found only when samples are read remains an error.
            options: those of ``Source.open``.

        Raises:
            ReadError: files cannot be read (all of them are named) or placed, the area cannot be shown flat, or the
                geoid grid is missing or does not cover it.
            UsageError: invalid options, or heights whose datum does not fit the conversion.
        """
        from orograph.dem.openers import opened
        from orograph.dem.source import Source

        names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
        found = opened(names, options, progress)
        sources, damaged = found.sources, found.damaged
        if damaged and not (skip_damaged and sources):
            raise unread(damaged, found.files)
        if len(sources) == 1 and min(sources[0].grid.shape) < 2:
            rows, cols = sources[0].grid.shape
            raise ReadError(
                f"The raster has {rows} × {cols} samples (rows × columns); a surface needs at least two of each.",
                path=found.sources[0].path,
                remedy="Give files that hold more, or also the adjacent files.",
            )
        usual = inspect.signature(Source.open).parameters
        made = cls(
            sources,
            crs=crs,
            resolution=resolution,
            resampling=resampling,
            to_vertical=to_vertical,
            geoid=geoid,
            bbox=bbox,
            clip=clip,
            options={name: value for name, value in options.items() if value != usual[name].default},
        )
        made.reading = {name: value for name, value in options.items() if value is not None}
        made.named = tuple(str(name) for name in names) if found.manifests else ()
        made.skipped = tuple(f"{error.path}: {error.what}" for error in damaged)
        if damaged:
            made.warnings.append(f"{_count(damaged, found.files)} left out: {_listed(damaged)}")
        return made

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a half-open window inside the grid: (row1-row0, col1-col0) float32 metres, NaN where missing.

        Safe from any thread; the same to the bit whatever the window.

        Raises:
            ReadError: a source is damaged there.
            ValueError: the window is empty or not inside the grid.
        """
        rows, cols = self.grid.shape
        if not (0 <= row0 < row1 <= rows and 0 <= col0 < col1 <= cols):
            raise ValueError(f"window [{row0}, {row1}) × [{col0}, {col1}) of a raster of {rows} × {cols}")
        out = filled(self.resampling, self._layers, row0, row1, col0, col1)
        if self.undulation is not None:
            self.undulation.apply(row0, col0, out)
        return out

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in the grid's CRS from the sources' own samples; NaN where there are none.

        They are bilinear on each source's own lattice, not on the grid, to which samples may have been resampled.

        Raises:
            ReadError: a source is damaged there.
        """
        return heights_at(self.grid, self._own, x, y)

    @property
    def lattices(self) -> tuple[SourceLattice, ...]:
        """Those of its sources, the finest first, with heights above its own vertical datum."""
        return tuple(layer.lattice for layer in self._own)

    @property
    def resampled_from(self) -> tuple[SourceLattice, ...]:
        """The lattices that were resampled, the finest first; none if every sample is a source's own."""
        return () if self.lossless else self.lattices

    @property
    def windows(self) -> list[tuple[int, int, int, int]]:
        """For each source, the rows and columns of the grid (half-open) that it may affect, with a margin."""
        found = {id(member): window for layer in self._layers for member, window in reaches(layer, self.grid)}
        return [found[id(source)] for source in self.sources]

    def fingerprint(self) -> str:
        """A hash of all files and all options: equal hashes mean equal samples.

        Files count by absolute path, size and modification time (``deciding.files_of``).
        """
        parts: list[str] = [
            repr(sorted(self._options.items(), key=str)),
            self.resampling,
            repr(self.grid.transform[:6]),
        ]
        parts += [repr(self.grid.shape), "" if self.grid.crs is None else self.grid.crs.to_wkt()]
        for source in self.sources:
            location = getattr(source, "location", None)
            parts += states([getattr(source, "path", source.name), *(files_of(location) if location else ())])
            if (fingerprint := getattr(source, "fingerprint", None)) is not None:  # for sources that are not files
                parts.append(fingerprint())
        if self.undulation is not None:
            parts += states([os.fspath(self.undulation.geoid.path)])
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def recipe(self) -> tuple[list[str], dict[str, Any]] | None:
        """Paths and options with which ``open`` makes the same mosaic again; None if a source is no file."""
        paths = [str(source.path) for source in self.sources if hasattr(source, "path")]
        if len(paths) < len(self.sources):
            return None
        options = {**self._options, "resampling": self.resampling}
        if options["crs"] is not None:
            options["crs"] = CRS.from_wkt(options["crs"]).to_string()
        if self.undulation is not None:
            options["geoid"] = str(Path(self.undulation.geoid.path).absolute())
        for recipe in (source.recipe for source in self.sources if hasattr(source, "recipe")):
            if (own := recipe()) is None:
                return None
            options = {k: v for k, v in {**options, **own[1]}.items() if v is not None}  # an area of points
        return paths, options

    def check_void(self) -> None:
        """Raise UsageError if it is huge and nearly all void, and neither spacing nor area were requested."""
        check_void(self.void, self.grid, any(self._options.get(name) is not None for name in ("resolution", "bbox")))

    def _check_bodies(self, grids: Sequence[Grid], wanted: CRS | None) -> None:
        """Raise ReadError or UsageError unless everything lies on one planet or moon."""
        for source, grid in zip(self.sources, grids):
            if grid.crs is None:
                continue
            path = getattr(source, "path", source.name)
            first = grids[0].crs
            if first is not None and not same_body(grid.crs, first):
                raise ReadError(
                    f"It is on a different planet or moon ({grid.crs.name}) from {self.sources[0].name} "
                    f"({first.name}): they cannot be combined.",
                    path=path,
                    remedy="Give files of one body.",
                )
            if wanted is not None and not same_body(grid.crs, wanted):
                raise UsageError(
                    f"It is on a different planet or moon ({grid.crs.name}) from the requested CRS ({wanted.name}).",
                    path=path,
                    remedy="Leave out `crs`, or give a projected CRS of that body.",
                )

    def _one_datum(self) -> str | None:
        datums = {s.vertical for s in self.sources}
        if len(datums - {None}) > 1:
            self.warnings.append(
                f"The files have heights above different datums ({', '.join(sorted(d for d in datums if d))}); they "
                "are combined unchanged, which leaves steps of up to tens of metres."
            )
        elif len(datums) > 1:
            self.warnings.append("Some of the files do not declare the datum of their heights.")
        return self.sources[0].vertical if len(datums) == 1 else None

    def _gather_warnings(self) -> None:
        seen = set(self.warnings)
        for source in self.sources:
            for text in getattr(source, "warnings", ()):
                if text not in seen:
                    seen.add(text)
                    self.warnings.append(text if len(self.sources) == 1 else f"{source.name}: {text}")
        if len(self.sources) > 1 and (text := void_warning(self.void, self.grid)) is not None:
            self.warnings.append(text)
        scale = scale_at_centre(self.grid)
        if self.projection == "as asked for":
            return
        least, most = scales(self.grid)
        if abs(scale - 1) > FALSE_SCALE or most > UNEVEN * least:
            assert self.grid.crs is not None
            uneven = most > UNEVEN * least
            remedy = "draw a smaller area, in a `crs` made for it," if uneven else "give `crs`, e.g. the UTM zone,"
            true = f"{1 / most:.3g} to {1 / least:.3g}" if uneven else f"{1 / scale:.3g}"
            self.warnings.append(
                f"A metre of {self.grid.crs.name} is {true} m on the ground here, so slopes come out wrong by "
                f"that factor; the samples are kept as they are ({remedy} for true proportions)."
            )

    def _warn_of_datums(self, lattices: Sequence[Lattice]) -> None:
        """Warn if another datum was converted by less than the best operation, and the error could be visible."""
        found: dict[str, str] = {}
        for lattice in lattices:
            if lattice.grid.crs is not None and self.grid.crs is not None:
                text = approximation(lattice.grid.crs, self.grid.crs, lattice.grid.bounds(), min(self.grid.spacing) / 2)
                if text is not None:
                    found.setdefault(text, lattice.members[0].name)
        several = len(lattices) > 1
        self.warnings.extend(f"{name}: {text}" if several else text for text, name in found.items())


TOLD = 20
"""Maximum number of damaged files that a message names."""


def unread(damaged: Sequence[ReadError], count: int) -> ReadError:
    """The error that lists all files that cannot be opened; for a single one, its own error."""
    if len(damaged) == 1:
        return damaged[0]
    return ReadError(
        f"{_count(damaged, count)} damaged or missing: {_listed(damaged)}",
        remedy="Repair or replace them, or skip them (`skip_damaged`), which leaves their ground missing.",
    )


def _count(damaged: Sequence[ReadError], count: int) -> str:
    return f"{len(damaged)} of {count} files {'is' if len(damaged) == 1 else 'are'}"


def _listed(damaged: Sequence[ReadError]) -> str:
    """Files with their causes, on separate lines if there are several."""
    lines = [f"{error.path}: {error.what}" for error in damaged[:TOLD]]
    more = [f"and {len(damaged) - TOLD} more"] if len(damaged) > TOLD else []
    return "\n  ".join(["", *lines, *more]) if len(damaged) > 1 else lines[0]
