"""Place rasters for a mosaic: horizontal, in metres east and north if projected, neighbours side by side.

Also the scale of a projected grid: map metres per metre on the ground.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import Proj

from orograph.dem.axes import east_north
from orograph.dem.lattice import Raster, full_turn
from orograph.dem.projection import horizontal, in_metres, unwrapped
from orograph.errors import ReadError
from orograph.geo.grid import Grid, compose


def placed(source: Raster, options: dict[str, Any], warnings: list[str]) -> Grid:
    """A source's grid in a horizontal CRS; if it is projected, in metres east and north.

    Raises:
        ReadError: the file has no place or size.
    """
    grid, path = source.grid, getattr(source, "path", source.name)
    if grid.crs is None or not (
        grid.crs.is_projected or grid.crs.is_geographic or grid.crs.is_bound or grid.crs.is_compound
    ):
        if options.get("spacing") is not None:
            return Grid(grid.shape, grid.transform, None)
        if not getattr(source, "georeferenced", True) or grid.transform == Affine.identity():
            raise ReadError(
                "It has neither georeferencing nor a spacing of samples.",
                path=path,
                remedy="Give the distance between samples in metres (`spacing=30`), or the CRS (`assume_crs`).",
            )
        west, south, east, north = grid.bounds()
        if max(abs(west), abs(east)) <= 360 and max(abs(south), abs(north)) <= 90.01 and max(grid.spacing) < 1:
            raise ReadError(
                f"It has no CRS and its extent ({west:.6g}…{east:.6g}, {south:.6g}…{north:.6g}) may be degrees.",
                path=path,
                remedy='Give it (`assume_crs="EPSG:4326"`), or give the metres between samples (`spacing=30`).',
            )
        warnings.append("It has no CRS; its coordinates are assumed to be metres (give `assume_crs=CODE`).")
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


def turned(grids: list[Grid]) -> list[Grid]:
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


def scale_at_centre(grid: Grid) -> float:
    """Map metres per ground metre at the centre of a projected grid; 1 where that is not defined."""
    scale = _scale(grid, np.array([(grid.cols - 1) / 2]), np.array([(grid.rows - 1) / 2]))
    return float(scale[0]) if scale.size else 1.0


def scales(grid: Grid) -> tuple[float, float]:
    """The smallest and the largest map metres per ground metre over a projected grid; 1, 1 where none are defined."""
    col, row = np.meshgrid(np.linspace(0, grid.cols - 1, 5), np.linspace(0, grid.rows - 1, 9))
    scale = _scale(grid, col.ravel(), row.ravel())
    return (float(scale.min()), float(scale.max())) if scale.size else (1.0, 1.0)


def areal_scales(grid: Grid, col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map metres² per ground metre² (n,) at samples (n,) of a grid; NaN where that is not defined."""
    found = np.full(len(col), np.nan)
    if grid.crs is None or not grid.crs.is_projected:
        return found
    proj = Proj(grid.crs)
    lon, lat = proj(*grid.xy(col, row), inverse=True)
    known = np.isfinite(lon) & np.isfinite(lat) & (np.abs(lat) <= 89.9)
    if known.any():
        scale = np.abs(np.asarray(proj.get_factors(lon[known], lat[known]).areal_scale))
        found[known] = np.where(np.isfinite(scale) & (scale > 0), scale, np.nan)
    return found


def _scale(grid: Grid, col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map metres per ground metre at those samples where that is defined."""
    scale = np.sqrt(areal_scales(grid, col, row))
    return np.asarray(scale[np.isfinite(scale)])
