"""Write meshes to files for other programs: .ply, .obj, .glb. (``Tessellation.save`` calls this; .npz is its own.)

All lengths are metres. PLY (binary, float64) and OBJ (text, micrometres) are in the terrain's CRS as it is: easting,
northing, height, z up; many viewers hold positions in float32, so they may be relative to an ``origin``, which their
comments hold. GLB is float32 by its standard (glTF 2.0, §3.6.2.2): positions are relative to an origin, which is
the node's translation; y is up, z points south (§3.4). The node's ``extras`` hold ``origin`` (easting, northing,
height) and ``crs`` (WKT): a position is (origin[0] + x, origin[1] − z, origin[2] + y). Faces turn counter-clockwise
from above in all of them.

Sources: Turk 1994 (*The PLY polygon file format*), Wavefront's *Advanced Visualizer* manual, appendix B1 (OBJ; colours
after the coordinates, as MeshLab and others have them), Khronos glTF 2.0.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph.errors import NothingInViewError, UsageError
from orograph.output import Beside
from orograph.several import Numbers, numbers

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]
Colors = NDArray[np.uint8]

Origin = Numbers
"""Easting, northing and perhaps a height; their text; or "auto"."""

FORMATS = (".npz", ".ply", ".obj", ".glb")
"""Endings of mesh files."""

LINES = 100_000
"""Lines of text formatted at once."""


def mesh_format(path: str | os.PathLike[str], more: Sequence[str] = ()) -> str:
    """The ending of a mesh file, in lower case; ``more``: other endings that messages name.

    Raises:
        UsageError: meshes cannot be written with this ending, or its writer is not installed.
    """
    ending = Path(path).suffix.lower()
    if ending in (".stl", ".3mf"):
        raise UsageError(
            f"A {ending} file is a model for printing, which has walls and a base.", path=path,
            remedy="Make it from the whole terrain: `orograph.tin(dem, max_error=5, output=path)`.",
        )  # fmt: skip
    if ending not in FORMATS:
        *others, last = [*FORMATS, *more]
        raise UsageError(
            f"Meshes cannot be written as {ending or 'a file without ending'}.",
            path=path,
            remedy=f"Use {', '.join(others)} or {last}.",
        )
    if ending == ".glb":
        _trimesh(path)
    return ending


def write(
    path: Path, positions: Array, triangles: Triangles, crs: CRS | None, *, colors: ArrayLike | None = None,
    origin: Origin | None = None,
) -> None:  # fmt: skip
    """Write a mesh; the format follows the ending.

    Args:
        path: ends in .ply, .obj or .glb; the file appears when it is complete.
        positions: (n, 3) easting, northing, height, metres. triangles: (m, 3), counter-clockwise from above.
        colors: (n, 3) uint8, sRGB by vertex.
        origin: easting, northing and height (0 if omitted) that positions are relative to, which the file says; "auto":
            whole metres in the middle of the mesh, at height 0. None: the CRS's own, in .glb "auto" with a height.

    Raises:
        UsageError: the ending is unknown, the colours have the wrong shape or type, or .glb is requested without its
            extra (``mesh``). NothingInViewError: a .glb without triangles, which is impossible.
        OutputError: the file cannot be written.
    """
    ending = mesh_format(path)
    if origin is not None:
        check_origin(origin, path)
    tint = None if colors is None else _tint(colors, len(positions))
    start = None if origin is None else origin_of(origin, positions)
    wkt = "" if crs is None else " ".join(crs.to_wkt().split())
    if ending == ".glb":
        if len(triangles) == 0:
            raise NothingInViewError("The mesh has no triangles, and a .glb cannot be empty.", path=path)
        middle = np.round((positions.min(0) + positions.max(0)) / 2) if start is None else np.array(start)
        content = _glb(positions, middle, triangles, tint, wkt, _trimesh(path))
        with Beside(path) as part:
            part.write_bytes(content)
        return
    notes = ["metres; x east, y north, z up", *([f"crs {wkt}"] if wkt else [])]
    if start is not None:
        positions = positions - start
        notes.append(f"origin {start[0]:.10g} {start[1]:.10g} {start[2]:.10g} (easting, northing, height: add it)")
    with Beside(path) as part:
        (_write_ply if ending == ".ply" else _write_obj)(part, positions, triangles, tint, notes)


def _tint(colors: ArrayLike, vertices: int) -> Colors:
    """Colours of vertices, checked."""
    tint = np.asarray(colors)
    if tint.dtype != np.uint8 or tint.shape != (vertices, 3):
        raise UsageError(f"Colours of vertices must be uint8 ({vertices}, 3), not {tint.dtype} {tint.shape}.")
    return tint


def check_origin(given: Origin, path: str | os.PathLike[str] | None) -> None:
    """Raise UsageError unless it is an origin, of a file that can have one."""
    origin_of(given, np.zeros((0, 3)))
    if path is None or Path(path).suffix.lower() not in (".ply", ".obj", ".glb", ".stl"):
        raise UsageError("`origin` applies to .ply, .obj, .glb and surfaces as .stl only.", path=path)


def origin_of(given: Origin, positions: NDArray[np.float64]) -> tuple[float, float, float]:
    """The origin (easting, northing, height) that is meant, for positions (n, 3).

    Raises:
        UsageError: it is neither "auto" nor two or three finite numbers.
    """
    if isinstance(given, str) and given == "auto":
        low, high = (positions.min(0), positions.max(0)) if len(positions) else (np.zeros(3), np.zeros(3))
        east, north, _ = np.round((low + high) / 2)
        return float(east), float(north), 0.0
    found = numbers(given, "origin")
    if len(found) not in (2, 3) or not all(map(math.isfinite, found)):
        raise UsageError(f'`origin` must be "auto", or easting, northing and perhaps a height, not {given!r}.')
    return found[0], found[1], found[2] if len(found) == 3 else 0.0


def _write_ply(
    part: Path, positions: Array, triangles: Triangles, colors: Colors | None,
    notes: list[str],
) -> None:  # fmt: skip
    """Binary, little endian, float64 positions."""
    vertex: list[Any] = [("position", "<f8", 3)]
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {note}" for note in notes)]
    header += [f"element vertex {len(positions)}", *(f"property double {axis}" for axis in "xyz")]
    if colors is not None:
        vertex.append(("color", "u1", 3))
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]
    vertices = np.empty(len(positions), vertex)
    vertices["position"] = positions
    if colors is not None:
        vertices["color"] = colors
    faces = np.empty(len(triangles), [("count", "u1"), ("indices", "<i4", 3)])
    faces["count"], faces["indices"] = 3, triangles
    with part.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def _write_obj(
    part: Path, positions: Array, triangles: Triangles, colors: Colors | None,
    notes: list[str],
) -> None:  # fmt: skip
    """Text; micrometres, indices from 1, colours from 0 to 1 after the coordinates."""
    with part.open("w", encoding="utf-8", newline="\n") as file:
        file.write("".join(f"# {note}\n" for note in notes))
        rows = positions if colors is None else np.hstack([positions, colors / 255.0])
        pattern = "v %.6f %.6f %.6f" + ("" if colors is None else " %.4f %.4f %.4f")
        for first in range(0, len(rows), LINES):
            block = rows[first : first + LINES]
            file.write("".join([pattern + "\n"] * len(block)) % tuple(block.ravel().tolist()))
        for first in range(0, len(triangles), LINES):
            corners = triangles[first : first + LINES].astype(np.int64) + 1
            file.write("f %d %d %d\n" * len(corners) % tuple(corners.ravel().tolist()))


def _glb(
    positions: NDArray[np.float64], origin: NDArray[np.float64], triangles: NDArray[np.int32], colors: Colors | None,
    crs: str, trimesh: Any,
) -> bytes:  # fmt: skip
    """One node, translated to the origin, with one mesh; no normals."""
    east, north, up = (positions - origin).T
    mesh = trimesh.Trimesh(
        vertices=np.stack([east, up, -north], -1), faces=triangles, vertex_colors=colors, process=False, validate=False
    )
    place = np.eye(4)
    place[:3, 3] = origin[0], origin[2], -origin[1]
    extras = {"origin": [float(v) for v in origin], "crs": crs}
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="terrain", geom_name="terrain", transform=place, metadata=extras)

    def translate(tree: dict[str, Any]) -> None:
        """A translation instead of a matrix, for readers without support for matrices."""
        (node,) = (node for node in tree["nodes"] if "mesh" in node)
        node.pop("matrix", None)
        node["translation"] = place[:3, 3].tolist()
        tree["asset"]["generator"] = "Orograph"

    content: bytes = trimesh.exchange.gltf.export_glb(scene, include_normals=False, tree_postprocessor=translate)
    return content


def _trimesh(path: str | os.PathLike[str]) -> Any:
    """The library that writes .glb files."""
    try:
        import trimesh
    except ImportError as error:
        raise UsageError(
            "A .glb file needs trimesh, which is not installed.", path=path, remedy="Run pip install 'orograph[mesh]'."
        ) from error
    return trimesh
