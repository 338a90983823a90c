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
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Proj

from orograph.dem.axes import east_north
from orograph.dem.lattice import Lattice, Raster, full_turn, group
from orograph.dem.layers import BUDGET, LatticeMap, averaged, layer_of, needed
from orograph.dem.points import heights_between
from orograph.dem.projection import horizontal, in_metres, unwrapped
from orograph.dem.resample import METHODS, sample
from orograph.dem.target import choose, ground_spacing, parse_crs
from orograph.dem.undulation import Direction, Undulation, check_datums, check_request, latitudes_of
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose
from orograph.geo.operations import approximation, same_body
from orograph.geo.vertical import Geoid
from orograph.progress import SILENT, Progress

PIECE = 1 << 22  # target samples resampled at once
STRIP = 256  # rows whose coordinates are held at once
UNEVEN = 1.1  # ratio of scales within a kept projection that is worth one, too
FALSE_SCALE = 0.01  # scale error of a kept projection from which on it is worth a warning

Heights = NDArray[np.float32]


class Mosaic:
    """One raster made of many.

    Attributes:
        grid: the terrain's grid: projected, metres (or local metres without a CRS).
        name: the file's stem, or that of the first and how many more.
        vertical: name of the vertical datum, None if unknown or mixed.
        warnings: what a user should know, full sentences.
        sources: the rasters, in order of precedence within a lattice.
        height_source: file names, for the store's metadata.
        projection: why the grid has its CRS ("UTM zone 11N", "as the source").
        lossless: whether every sample is a source's own, none interpolated.
        resampling: "nearest", "bilinear" or "cubic".
        undulation: the conversion of heights that was asked for, or None.
        dtypes: the stored types of the sources, e.g. ("int16",).
    """

    def __init__(
        self,
        sources: Sequence[Raster],
        *,
        crs: str | CRS | None = None,
        resolution: float | None = None,
        resampling: str = "bilinear",
        to_vertical: Direction | None = None,
        geoid: Geoid | str | os.PathLike[str] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        if resampling not in METHODS:
            raise UsageError(f"The resampling must be one of {', '.join(METHODS)}, not {resampling!r}.")
        if not sources:
            raise UsageError("There is no file to read.")
        check_request(to_vertical, geoid)
        wanted = None if crs is None else parse_crs(crs)
        self.sources: tuple[Raster, ...] = tuple(sources)
        self.resampling = resampling
        self.warnings: list[str] = []
        grids = _turned([_placed(s, options or {}, self.warnings) for s in self.sources])
        if len({g.crs is None for g in grids}) == 2:
            nameless = next(s for s, g in zip(self.sources, grids) if g.crs is None)
            raise ReadError(
                "It has no CRS while other files have one: they cannot be put together.",
                path=getattr(nameless, "path", nameless.name),
                remedy="Give the CRS of such files with `assume_crs`.",
            )
        if wanted is not None and grids[0].crs is None:
            raise UsageError(
                "The files have no CRS, so they cannot be brought to another.", remedy="Give theirs: `assume_crs`."
            )
        self._check_bodies(grids, wanted)
        lattices = sorted(group(self.sources, grids), key=lambda g: float(f"{ground_spacing(g.grid):.4g}"))
        target = choose(lattices, crs=wanted, resolution=resolution)
        self.grid = target.grid
        self.projection = target.reason
        self._layers = [layer_of(lattice, target.grid, resampling) for lattice in lattices]
        self.lossless = all(layer.offset is not None for layer in self._layers)
        self.name = self.sources[0].name + (f" and {len(sources) - 1} more" if len(sources) > 1 else "")
        self.height_source = [Path(getattr(s, "path", s.name)).name for s in self.sources]
        self.dtypes = tuple(sorted({str(getattr(s, "dtype", "float32")) for s in self.sources}))
        self.vertical = self._one_datum()
        self.undulation: Undulation | None = None
        if to_vertical is not None and geoid is not None:
            grid = geoid if isinstance(geoid, Geoid) else Geoid.open(geoid, latitudes=latitudes_of(lattices))
            check_datums(self.sources, to_vertical, grid)
            self.undulation = Undulation(grid, to_vertical, self.grid, lattices)
            self.vertical = self.undulation.vertical
        self._options = {
            "crs": None if wanted is None else wanted.to_wkt(),
            "resolution": resolution,
            "to_vertical": to_vertical,
            **(options or {}),
        }
        self._gather_warnings()
        self._warn_of_datums(lattices)

    @classmethod
    def open(
        cls,
        paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        *,
        crs: str | CRS | None = None,
        resolution: float | None = None,
        resampling: str = "bilinear",
        to_vertical: Direction | None = None,
        geoid: Geoid | str | os.PathLike[str] | None = None,
        progress: Progress = SILENT,
        **options: Any,
    ) -> Mosaic:
        """Open files (headers only) and choose the grid that holds them all.

        Args:
            paths: one file or many; of those on one lattice the first named wins where several have a sample.
            crs: projected CRS of the terrain; one in feet is used with metre axes.
            resolution: metres between samples of the terrain.
            resampling: "nearest", "bilinear" or "cubic"; has no effect where samples are kept.
            to_vertical: "ellipsoidal" or "orthometric": convert heights to those above the ellipsoid, or the geoid.
            geoid: the geoid grid, or its file, by which to convert.
            options: those of ``Source.open``.

        Raises:
            ReadError: a file cannot be read or placed, the area cannot be shown flat, or the geoid grid is missing or
                does not cover it.
            UsageError: options that cannot be understood, or heights of another datum than a conversion starts from.
        """
        from orograph.dem.source import Source

        names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
        sources: list[Raster] = []
        with progress.task("Opening files", total=len(names)) as task:
            for path in names:
                sources.append(Source.open(path, **options))
                task.advance()
        if len(sources) == 1 and min(sources[0].grid.shape) < 2:
            rows, cols = sources[0].grid.shape
            raise ReadError(
                f"The raster has {rows} row(s) and {cols} column(s); a surface needs at least two of each.",
                path=names[0],
                remedy="Name files that hold more, or the files beside it as well.",
            )
        return cls(
            sources,
            crs=crs,
            resolution=resolution,
            resampling=resampling,
            to_vertical=to_vertical,
            geoid=geoid,
            options=options,
        )

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
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        for i, layer in enumerate(self._layers):
            a, b = max(row0, layer.box[0]), min(row1, layer.box[1])
            c, d = max(col0, layer.box[2]), min(col1, layer.box[3])
            if a < b and c < d:
                part = out[a - row0 : b - row0, c - col0 : d - col0]
                if i == 0 or np.isnan(part).any():
                    self._fill(layer, a, b, c, d, part)
        if self.undulation is not None:
            self.undulation.apply(row0, col0, out)
        return out

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in the grid's CRS out of the sources' own samples, bilinear on their own lattice
        (not on the grid, to which they may have been resampled); NaN where there is none.

        Raises:
            ReadError: a source is damaged there.
        """
        col, row = self.grid.index(np.atleast_1d(x), np.atleast_1d(y))
        out = np.full(col.shape, np.nan)
        for layer in self._layers:
            lost = np.flatnonzero(np.isnan(out))
            if not len(lost):
                break
            if layer.coordinates is None:
                assert layer.offset is not None
                u, v = col[lost] + layer.offset[1], row[lost] + layer.offset[0]
            else:
                u, v = layer.coordinates.exact(col[lost], row[lost])
            out[lost] = heights_between(layer.lattice.read, layer.lattice.grid.shape, u, v)
        if self.undulation is not None:
            self.undulation.apply_at(col, row, out)
        return out

    def fingerprint(self) -> str:
        """A hash of the files (absolute path, size, time of change) and all options: if equal, so are the samples."""
        said: list[str] = [repr(sorted(self._options.items(), key=str)), self.resampling, repr(self.grid.transform[:6])]
        said += [repr(self.grid.shape), "" if self.grid.crs is None else self.grid.crs.to_wkt()]
        paths = [getattr(source, "path", source.name) for source in self.sources]
        if self.undulation is not None:
            paths.append(self.undulation.geoid.path)
        for path in map(Path, paths):
            said.append(str(path.absolute()))
            if path.exists():
                found = path.stat()
                said.append(f"{found.st_size} {found.st_mtime_ns}")
        return hashlib.sha256("\n".join(said).encode()).hexdigest()

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
        return paths, options

    def _fill(self, layer: LatticeMap, row0: int, row1: int, col0: int, col1: int, out: Heights) -> None:
        """Give the missing samples of ``out`` (that window) the values of one lattice."""
        if layer.offset is not None:
            r, c = layer.offset
            found = layer.lattice.read(row0 + r, row1 + r, col0 + c, col1 + c)
            np.copyto(out, found, where=np.isnan(out))
            return
        assert layer.coordinates is not None
        reach = mesh = None
        if (row1 - row0) * (col1 - col0) <= PIECE:
            mesh = layer.coordinates.mesh(row0, row1, col0, col1)
            reach = needed(layer, mesh)
            if reach is None:
                return
        if (
            mesh is None
            or reach is None
            or ((reach[1] - reach[0]) * (reach[3] - reach[2]) > BUDGET and max(out.shape) > 16)
        ):
            if row1 - row0 >= col1 - col0:
                middle = (row0 + row1) // 2
                self._fill(layer, row0, middle, col0, col1, out[: middle - row0])
                self._fill(layer, middle, row1, col0, col1, out[middle - row0 :])
            else:
                middle = (col0 + col1) // 2
                self._fill(layer, row0, row1, col0, middle, out[:, : middle - col0])
                self._fill(layer, row0, row1, middle, col1, out[:, middle - col0 :])
            return
        window = averaged(layer, *reach)
        k_rows, k_cols = layer.means
        for r in range(row0, row1, STRIP):
            end = min(r + STRIP, row1)
            u, v = mesh.positions(r, end, col0, col1)
            if layer.means != (1, 1):
                u, v = (u - (k_cols - 1) / 2) / k_cols, (v - (k_rows - 1) / 2) / k_rows
            sample(self.resampling, window, reach[0], reach[2], u, v, out[r - row0 : end - row0])

    def _check_bodies(self, grids: Sequence[Grid], wanted: CRS | None) -> None:
        """Raise ReadError or UsageError unless everything lies on one planet or moon."""
        for source, grid in zip(self.sources, grids):
            if grid.crs is None:
                continue
            path = getattr(source, "path", source.name)
            first = grids[0].crs
            if first is not None and not same_body(grid.crs, first):
                raise ReadError(
                    f"It is of another planet or moon ({grid.crs.name}) than {self.sources[0].name} ({first.name}): "
                    "they cannot be put together.",
                    path=path,
                    remedy="Name files of one body.",
                )
            if wanted is not None and not same_body(grid.crs, wanted):
                raise UsageError(
                    f"It is of another planet or moon ({grid.crs.name}) than the CRS asked for ({wanted.name}).",
                    path=path,
                    remedy="Leave `crs` away, or give a projected CRS of that body.",
                )

    def _one_datum(self) -> str | None:
        datums = {s.vertical for s in self.sources}
        if len(datums - {None}) > 1:
            self.warnings.append(
                f"The files have heights above different datums ({', '.join(sorted(d for d in datums if d))}); "
                "they are put together as they are, which leaves steps of up to tens of metres."
            )
        elif len(datums) > 1:
            self.warnings.append("Some of the files do not say above which datum their heights are.")
        return self.sources[0].vertical if len(datums) == 1 else None

    def _gather_warnings(self) -> None:
        seen = set(self.warnings)
        for source in self.sources:
            for text in getattr(source, "warnings", ()):
                if text not in seen:
                    seen.add(text)
                    self.warnings.append(text if len(self.sources) == 1 else f"{source.name}: {text}")
        scale = _scale_at_centre(self.grid)
        if self.projection == "as asked for":
            return
        least, most = _scales(self.grid)
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
        """Say where positions come from another datum by less than the best way there is, if that could be seen."""
        said: dict[str, str] = {}
        for lattice in lattices:
            if lattice.grid.crs is not None and self.grid.crs is not None:
                text = approximation(lattice.grid.crs, self.grid.crs, lattice.grid.bounds(), min(self.grid.spacing) / 2)
                if text is not None:
                    said.setdefault(text, lattice.members[0].name)
        several = len(lattices) > 1
        self.warnings.extend(f"{name}: {text}" if several else text for text, name in said.items())


def _placed(source: Raster, options: dict[str, Any], warnings: list[str]) -> Grid:
    """A source's grid in a horizontal CRS; if it is projected, in metres east and north.

    Raises:
        ReadError: the file does not say where or how large it is.
    """
    grid, path = source.grid, getattr(source, "path", source.name)
    if grid.crs is None or not (
        grid.crs.is_projected or grid.crs.is_geographic or grid.crs.is_bound or grid.crs.is_compound
    ):
        if options.get("spacing") is not None:
            return Grid(grid.shape, grid.transform, None)
        if not getattr(source, "georeferenced", True) or grid.transform == Affine.identity():
            raise ReadError(
                "It does not say where it lies or how far apart its samples are.",
                path=path,
                remedy="Give the distance between samples in metres (`spacing=30`), or the CRS (`assume_crs`).",
            )
        west, south, east, north = grid.bounds()
        if max(abs(west), abs(east)) <= 360 and max(abs(south), abs(north)) <= 90.01 and max(grid.spacing) < 1:
            raise ReadError(
                f"It has no CRS and its extent ({west:.6g}…{east:.6g}, {south:.6g}…{north:.6g}) may be degrees.",
                path=path,
                remedy='Say so (`assume_crs="EPSG:4326"`), or give the metres between samples (`spacing=30`).',
            )
        warnings.append("There is no CRS; its coordinates are taken for metres (give the CRS with `assume_crs`).")
        warnings[:] = list(dict.fromkeys(warnings))
        return Grid(grid.shape, grid.transform, None)
    crs = horizontal(grid.crs)
    if crs.is_geographic:
        return Grid(grid.shape, grid.transform, crs)
    if not crs.is_projected:
        raise ReadError(
            f"Its CRS ({crs.name}) is neither projected nor geographic.", path=path, remedy="Give `assume_crs`."
        )
    crs, turn = east_north(crs)
    crs, unit = in_metres(crs)
    plain = unit == 1 and turn.is_identity
    return Grid(grid.shape, grid.transform if plain else compose(Affine.scale(unit), turn, grid.transform), crs)


def _turned(grids: list[Grid]) -> list[Grid]:
    """Geographic grids moved by whole turns of longitude so that neighbours across the antimeridian are neighbours."""
    which = [i for i, g in enumerate(grids) if g.crs is not None and g.crs.is_geographic]
    if len(which) < 2:
        return grids
    turn = np.array([full_turn(grids[i]) for i in which])
    middle = np.array([float(grids[i].xy((grids[i].cols - 1) / 2, 0)[0]) for i in which])
    wanted = unwrapped(middle / turn * 360.0) / 360.0 * turn
    out = list(grids)
    for i, turns, full in zip(which, np.round((wanted - middle) / turn), turn):
        if turns:
            out[i] = Grid(
                grids[i].shape, compose(Affine.translation(turns * full, 0), grids[i].transform), grids[i].crs
            )
    return out


def _scale_at_centre(grid: Grid) -> float:
    """Map metres per ground metre at the centre of a projected grid; 1 where that is not defined."""
    scale = _scale(grid, np.array([(grid.cols - 1) / 2]), np.array([(grid.rows - 1) / 2]))
    return float(scale[0]) if scale.size else 1.0


def _scales(grid: Grid) -> tuple[float, float]:
    """The smallest and the largest map metres per ground metre over a projected grid; 1, 1 where none are defined."""
    col, row = np.meshgrid(np.linspace(0, grid.cols - 1, 5), np.linspace(0, grid.rows - 1, 9))
    scale = _scale(grid, col.ravel(), row.ravel())
    return (float(scale.min()), float(scale.max())) if scale.size else (1.0, 1.0)


def _scale(grid: Grid, col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map metres per ground metre at those samples where that is defined."""
    if grid.crs is None or not grid.crs.is_projected:
        return np.ones(0)
    proj = Proj(grid.crs)
    lon, lat = proj(*grid.xy(col, row), inverse=True)
    known = np.isfinite(lon) & np.isfinite(lat) & (np.abs(lat) <= 89.9)
    if not known.any():
        return np.ones(0)
    factors = proj.get_factors(lon[known], lat[known])
    scale = np.sqrt(np.abs(np.asarray(factors.areal_scale)))
    return np.asarray(scale[np.isfinite(scale) & (scale > 0)])
