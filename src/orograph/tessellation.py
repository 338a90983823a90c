"""The mesh that a method makes of a terrain: ``Tessellation``, triangles over the full-resolution grid.

A vertex is (column, row, height in true metres), on a sample or between samples; no vertex occurs twice. Triangles turn
counter-clockwise seen from above in map orientation (east to the right, north up), whichever way the rows of the raster
run; none has zero area. The strip, where a method makes one, is a generalised triangle strip (Lindstrom & Pascucci
2001, §3.4): indices into the vertices, in which repeated indices make triangles of zero area that turn corners.

Methods on right triangles work on the padded square of 2^n + 1 samples and hand over keys ``row << 32 | col`` of its
vertices (``from_triangles``, ``from_strip``); here they are squeezed onto the raster and welded.
"""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from orograph._named import named
from orograph.cards import amount, card, heights_row
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.mesh_files import Origin, check_origin, mesh_format, write
from orograph.mesh_models import MODELS, Print, solid, write_solid
from orograph.output import Beside


@named("A tessellation")
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tessellation:
    """A triangle mesh over a terrain.

    Attributes:
        vertices: (n, 3) float64: column, row, height in true metres; columns and rows are those of the full-resolution
            grid, sample centres at integers.
        triangles: (m, 3) int32, indices into ``vertices``, counter-clockwise from above in map orientation.
        strip: (k,) int32, a generalised triangle strip of the same triangles whose first one has the orientation of
            ``triangles``; None if the method makes no strip.
        stats: what the method reports, as JSON values: method, error, metric, tolerance, conservative, …; geomorph if
            vertices on samples may be moving from other heights.
        grid: the full-resolution grid that columns and rows refer to, if known (it is for meshes made by the verbs).

    Raises:
        UsageError: an array has another shape or type, or an index points at no vertex.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    strip: NDArray[np.int32] | None = None
    stats: dict[str, Any] = field(default_factory=dict)
    grid: Grid | None = None

    def __post_init__(self) -> None:
        _check("vertices", self.vertices, np.float64, (None, 3))
        _check("triangles", self.triangles, np.int32, (None, 3))
        _check_indices("triangles", self.triangles, len(self.vertices))
        if self.strip is not None:
            _check("strip", self.strip, np.int32, (None,))
            _check_indices("strip", self.strip, len(self.vertices))

    def __repr__(self) -> str:
        strip = "" if self.strip is None else f", a strip of {len(self.strip):,}"
        method = f"{self.stats['method']}: " if "method" in self.stats else ""
        return (
            f"<Tessellation {method}{len(self.triangles):,} triangles, {len(self.vertices):,} vertices{strip}, "
            f"{amount(self.nbytes)}>"
        )

    def _repr_html_(self) -> str:
        told = [("triangles", f"{len(self.triangles):,}"), ("vertices", f"{len(self.vertices):,}")]
        told += [] if self.strip is None else [("strip", f"{len(self.strip):,}")]
        if len(self.vertices):
            told.append(heights_row(float(self.vertices[:, 2].min()), float(self.vertices[:, 2].max()), None))
        told += [(k, f"{v:g}") for k in ("tolerance", "refine_ms") if isinstance(v := self.stats.get(k), float)]
        name = str(self.stats.get("method", "mesh"))
        return card("tessellation", name, [*told, ("memory", amount(self.nbytes))])

    @property
    def nbytes(self) -> int:
        """The size of its arrays, bytes."""
        strip = 0 if self.strip is None else self.strip.nbytes
        return self.vertices.nbytes + self.triangles.nbytes + strip

    # ---- from methods ----------------------------------------------------------------------------------------------

    @classmethod
    def from_triangles(
        cls, grid: Grid, keys: ArrayLike, heights: ArrayLike, *, clockwise: bool, stats: dict[str, Any] | None = None
    ) -> Self:
        """Weld triangles whose corners are keys of the padded square.

        Args:
            grid: the terrain's full-resolution grid.
            keys: (m, 3) int64, ``row << 32 | col`` of each corner; rows and columns beyond the raster are squeezed onto
                its last ones, and triangles that thereby lose their area are dropped.
            heights: (m, 3) float32, the height of each corner, metres.
            clockwise: the orientation of all triangles with columns to the right and *rows downwards*.
            stats: see ``Tessellation``.

        Raises:
            UsageError: the arrays have other shapes or types.
        """
        from orograph._weld import weld_triangles

        k, h = np.ascontiguousarray(keys), np.ascontiguousarray(heights)
        _check("keys", k, np.int64, (None, 3))
        _check("heights", h, np.float32, k.shape)
        vertices, triangles = weld_triangles(k, h, grid.rows, grid.cols, clockwise == (turn(grid) < 0))
        return cls(vertices, triangles, None, {} if stats is None else stats)

    @classmethod
    def from_strip(
        cls, grid: Grid, keys: ArrayLike, heights: ArrayLike, *, clockwise: bool, stats: dict[str, Any] | None = None
    ) -> Self:
        """Weld a generalised triangle strip whose vertices are keys of the padded square.

        Triangle i joins the strip's vertices i, i + 1 and i + 2; every second one has the opposite orientation and is
        flipped; triangles of zero area are skipped.

        Args:
            grid, stats: as ``from_triangles``.
            keys: (k,) int64, ``row << 32 | col``.
            heights: (k,) float32, metres.
            clockwise: the orientation of triangle 0 (even if its area is zero) with columns to the right and *rows
                downwards*.

        Raises:
            UsageError: the arrays have other shapes or types.
        """
        from orograph._weld import weld_strip

        k, h = np.ascontiguousarray(keys), np.ascontiguousarray(heights)
        _check("keys", k, np.int64, (None,))
        _check("heights", h, np.float32, k.shape)
        vertices, strip, triangles = weld_strip(k, h, grid.rows, grid.cols, clockwise == (turn(grid) < 0))
        return cls(vertices, triangles, strip, {} if stats is None else stats)

    # ---- places ----------------------------------------------------------------------------------------------------

    def positions(self, grid: Grid | None = None) -> NDArray[np.float64]:
        """The vertices in the grid's CRS: (n, 3) easting, northing, height in metres; None: the mesh's own grid."""
        grid = self._grid(grid)
        x, y = grid.xy(self.vertices[:, 0], self.vertices[:, 1])
        return np.stack([x, y, self.vertices[:, 2]], -1)

    # ---- files -----------------------------------------------------------------------------------------------------

    def save(
        self, path: str | os.PathLike[str], grid: Grid | None = None, *, colors: ArrayLike | None = None,
        origin: Origin | None = None,
    ) -> Path:  # fmt: skip
        """Write the mesh; the format follows the ending.

        Args:
            path: ends in .npz (everything, for ``load`` and NumPy), .ply, .obj or .glb (``orograph.mesh_files``), or,
                for a TIN, .stl or .3mf: a closed model for 3D printing of the usual size (``orograph.tin`` makes
                others).
            grid: the one that columns and rows refer to; None: the mesh's own.
            colors: (n, 3) uint8, sRGB by vertex. origin: easting, northing and perhaps a height that positions are
                relative to, or "auto"; both for .ply, .obj and .glb only.

        The arrays of an .npz: ``vertices``, ``triangles``, ``strip`` (if there is one), ``stats`` (a JSON string); and
        the grid's ``shape`` (rows, cols), ``transform`` (the six numbers of GDAL's affine map in the order a, b, c, d,
        e, f) and ``crs`` (WKT, empty if unknown).

        Raises:
            UsageError: the ending is unknown or does not suit the mesh or its options, no grid is known, or the
                statistics are not JSON. NothingInViewError: the format needs triangles, and there are none.
                OutputError: the file cannot be written.
        """
        grid, out = self._grid(grid), Path(path)
        model = out.suffix.lower() in MODELS and self.stats.get("method") == "tin"
        ending = out.suffix.lower() if model else mesh_format(out)
        if origin is not None:
            check_origin(origin, None if model else out)
        if colors is not None and (model or ending == ".npz"):
            raise UsageError(f"{ending} files cannot hold colours.", path=out, remedy="Write a .ply.")
        if model:
            write_solid(solid(self.positions(grid), self.triangles, Print()), out, out.stem)
        elif ending == ".npz":
            self._save_arrays(out, grid)
        else:
            write(out, self.positions(grid), self.triangles, grid.crs, colors=colors, origin=origin)
        return out

    def _save_arrays(self, out: Path, grid: Grid) -> None:
        try:
            stats = json.dumps(self.stats, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise UsageError(f"The statistics of the tessellation are not JSON: {error}.", path=out) from error
        arrays: dict[str, NDArray[Any]] = {
            "vertices": self.vertices,
            "triangles": self.triangles,
            "stats": np.array(stats),
            "shape": np.array(grid.shape, np.int64),
            "transform": np.array(grid.transform[:6], np.float64),
            "crs": np.array("" if grid.crs is None else grid.crs.to_wkt()),
        }
        if self.strip is not None:
            arrays["strip"] = self.strip
        with Beside(out) as part, part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    def _grid(self, given: Grid | None) -> Grid:
        if (grid := given or self.grid) is None:
            raise UsageError("This mesh has no grid.", remedy="Give that of the terrain: `terrain.grid`.")
        return grid

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what ``save`` wrote; ``grid`` is the one it was saved with.

        Raises:
            ReadError: the file cannot be read, or is not a tessellation.
        """
        from pyproj import CRS

        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            rows, cols = (int(v) for v in arrays["shape"])
            wkt = str(arrays["crs"])
            crs = CRS.from_wkt(wkt) if wkt else None
            grid = Grid((rows, cols), Affine(*map(float, arrays["transform"])), crs)
            stats = json.loads(str(arrays["stats"]))
            return cls(arrays["vertices"], arrays["triangles"], arrays.get("strip"), stats, grid)
        except OSError as error:
            raise ReadError(f"The tessellation cannot be read: {error.strerror or error}.", path=path) from error
        except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, UsageError) as error:
            raise ReadError(
                f"This is not a tessellation: {error}.",
                path=path,
                remedy="Make one with orograph tessellate -o NAME.npz.",
            ) from error


def welded(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Points (n, 3), each once, and the number of each among them (n,). (``np.unique`` of rows takes far longer.)"""
    order = np.lexsort(points.T)
    ranked = points[order]
    new = np.ones(len(ranked), bool)
    new[1:] = (ranked[1:] != ranked[:-1]).any(1)
    where = np.empty(len(ranked), np.int32)
    where[order] = np.cumsum(new) - 1
    return ranked[new], where


def turn(grid: Grid) -> int:
    """+1 if the sample coordinates (col, row) have the map's handedness, −1 if mirrored (rows that run southwards).

    A triangle is counter-clockwise on the map iff its signed area in (col, row) has this sign.
    """
    return 1 if grid.transform.determinant > 0 else -1


def _check(name: str, array: NDArray[Any], dtype: Any, shape: tuple[int | None, ...]) -> None:
    """Raise UsageError unless ``array`` is an array of that type and shape (None: any length)."""
    kind = np.dtype(dtype)
    fits = (
        isinstance(array, np.ndarray)
        and array.dtype == kind
        and array.ndim == len(shape)
        and all(want is None or have == want for have, want in zip(array.shape, shape))
    )
    if not fits:
        size = ", ".join("n" if side is None else str(side) for side in shape)
        is_now = f"{array.dtype.name} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise UsageError(f"A tessellation's {name} must be {kind.name} ({size}), not {is_now}.")


def _check_indices(name: str, indices: NDArray[np.int32], count: int) -> None:
    """Raise UsageError unless all indices point at one of ``count`` vertices."""
    if indices.size and not (int(indices.min()) >= 0 and int(indices.max()) < count):
        raise UsageError(f"The {name} of the tessellation point at vertices that it does not have ({count} vertices).")
