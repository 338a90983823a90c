"""``orograph.tin``: an irregular triangulation that represents a terrain within a bound in metres."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._named import answering
from orograph.compiling import expect
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.mesh_files import Origin, check_origin, mesh_format, origin_of
from orograph.mesh_models import MODELS, Print, solid, write_solid, write_surface
from orograph.meshing import tin as meshing
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.scene.parts import check_exaggeration
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation


@answering
def tin(
    terrain: Any,
    max_error: float | None = None,
    *,
    triangles: int | None = None,
    bound: Literal["surface", "samples"] = "surface",
    breaklines: str | os.PathLike[str] | Sequence[ArrayLike] | None = None,
    output: str | os.PathLike[str] | None = None,
    origin: Origin | None = None,
    surface: bool = False,
    base: float | None = None,
    model_size: float | None = None,
    scale: float | None = None,
    exaggeration: float | None = None,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Tessellation:
    """Triangulate a terrain with as few triangles as a bound allows: a view-independent TIN.

    Its vertices are samples of the terrain, with their heights; holes stay holes, to the sample. The result is the same
    for any number of threads. Garland & Heckbert 1995 (*Fast polygonal approximation of terrains and height fields*),
    within a bound on the surface, and without the vertices that the bound does not need.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        max_error: how far the TIN may be off vertically, metres. triangles: instead: the maximum number of triangles,
            with the lowest bound that is found.
        bound: where it holds: everywhere on the surface, or only at samples, which takes fewer triangles.
        breaklines: lines that become edges, and points that become vertices, at the nearest samples: a GeoJSON file, or
            arrays (n, 2) of easting and northing, each a line (or a point if n is 1).
        output: also write it: .npz, .ply, .obj or .glb; or, as a closed model for 3D printing, .stl or .3mf, in
            millimetres.
        origin: of .ply, .obj and .glb: easting, northing and height (0 if omitted) that positions are relative to, or
            "auto": whole metres in the middle of the mesh. The file and ``stats["origin"]`` say it.
        surface: write an .stl of the open surface in metres, relative to ``origin`` (None: "auto"), instead of a model.
        base: of a model: millimetres from the plate to the lowest ground; None: 3.
        model_size: of a model: millimetres of its longer side; None: 150. scale: instead: the N of 1:N.
        exaggeration: of a model's heights; None: 1.
        max_memory: bytes that heights and tiles in progress may take; the mesh takes more. jobs: threads.
        progress: gets progress reports; False: silent.

    Returns:
        the mesh; ``stats`` has max_error, bound, and the actual errors in metres: ``largest`` on the surface,
        ``largest_at_samples``; of a model ``model``: its ``size_mm``, ``scale``, ``triangles`` and ``volume_cm3``.

    Raises:
        UsageError: an option makes no sense. ReadError, StoreError: the terrain cannot be read. NothingInViewError: it
            has no surface. OutputError: the file cannot be written.
    """
    max_memory = bytes_of(max_memory)
    check_goal(max_error, triangles)
    heard = reporting(progress)
    expect("tin")
    how = print_of(output, base, model_size, scale, exaggeration, surface)
    if origin is not None:
        check_origin(origin, None if how is not None else output)
    if output is not None:
        if how is None and not surface:
            mesh_format(output, MODELS)
        check_folder(Path(output))
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="tin", **reading)
    lines = [] if breaklines is None else lines_of(ground, breaklines)
    more: dict[str, Any] = {"bound": bound, "lines": lines, "max_memory": max_memory, "jobs": jobs, "progress": heard}
    if triangles is not None:
        mesh = meshing.tin_of_size(ground, triangles, **more)
        if len(mesh.triangles) > triangles:
            heard.warn(f"The coarsest TIN has {len(mesh.triangles):,} triangles, more than {triangles:,}.")
    else:
        assert max_error is not None
        mesh = meshing.tin(ground, float(max_error), **more)  # (a whole number would compile the kernels again)
    if output is not None:
        with heard.task("Writing"):
            if surface:
                start = write_surface(mesh.positions(), mesh.triangles, Path(output), origin or "auto")
                mesh.stats["origin"] = list(start)
            elif how is None:
                mesh.save(output, origin=origin)
                if origin is not None:
                    mesh.stats["origin"] = list(origin_of(origin, mesh.positions()))
            else:
                made = solid(mesh.positions(), mesh.triangles, how)
                write_solid(made, Path(output), ground.name)
                mesh.stats["model"] = {"size_mm": [round(v, 3) for v in made.size], "scale": made.scale,
                                       "triangles": len(made.triangles), "volume_cm3": made.volume / 1000}  # fmt: skip
    return mesh


def print_of(
    output: str | os.PathLike[str] | None, base: float | None, model_size: float | None, scale: float | None,
    exaggeration: float | None, surface: bool = False,
) -> Print | None:  # fmt: skip
    """How a model is printed; None if the output is not a model, but perhaps an open ``surface`` as .stl.

    Raises:
        UsageError: options of a model are given without one, or make no sense.
    """
    said = {"base": base, "model_size": model_size, "scale": scale, "exaggeration": exaggeration}
    given = {name: value for name, value in said.items() if value is not None}
    ending = "" if output is None else Path(output).suffix.lower()
    if surface and (ending != ".stl" or given):
        what = f"`{next(iter(given))}` applies to models to print" if given else "`surface` applies to .stl files"
        raise UsageError(f"{what} only.", path=output, remedy="A `surface` is an open .stl in metres.")
    if surface or output is None or Path(output).suffix.lower() not in MODELS:
        if given:
            raise UsageError(
                f"`{next(iter(given))}` applies to printable models only.",
                path=output,
                remedy="Write an .stl or a .3mf.",
            )
        return None
    if "exaggeration" in given:
        check_exaggeration(given["exaggeration"])
    if "model_size" in given:
        given["size"] = given.pop("model_size")
    return Print(**given)


def lines_of(terrain: Terrain, given: str | os.PathLike[str] | Sequence[ArrayLike]) -> list[NDArray[np.float64]]:
    """Break lines as columns and rows of the terrain."""
    if isinstance(given, str | os.PathLike):
        from orograph.measuring.geojson import read_lines
        from orograph.measuring.places import Places

        lines = read_lines(given, Places(terrain))
    else:
        try:
            lines = [np.asarray(line, np.float64).reshape(-1, 2) for line in given]
        except (TypeError, ValueError) as error:
            raise UsageError(f"Break lines must be arrays (n, 2) of easting and northing: {error}.") from error
    return [np.stack(terrain.grid.index(line[:, 0], line[:, 1]), -1) for line in lines]


def check_goal(max_error: float | None, triangles: int | None) -> None:
    """Raise UsageError unless exactly one of the two is given."""
    if (max_error is None) == (triangles is None):
        which = "either `max_error` or `triangles`" if max_error is None else "only one of `max_error` and `triangles`"
        raise UsageError(f"Give {which}: how fine the TIN should be.", remedy="`max_error=5`: within 5 m everywhere.")
