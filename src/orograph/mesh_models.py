"""Models for printing: a terrain's mesh as a solid with walls and a flat base, in millimetres (.stl, .3mf).

The top is the mesh itself, the bottom its mirror image on the plate, and there is a wall along every border, including
those of missing ground. So each edge belongs to exactly two triangles, and all face outward. Where parts of the ground
meet in a single vertex, each but one gets its own vertex, a hundredth of the way into its middle triangle, because a
vertical edge of four walls is not manifold.

Sources: 3D Systems 1988 (STL, binary: float32, millimetres by custom), 3MF Consortium, *Core Specification* 1.3 (§3,
§4: millimetres, indexed triangles, counter-clockwise from outside).
"""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError, UsageError
from orograph.mesh_files import Array, Origin, Triangles, origin_of
from orograph.output import Beside

MODELS = (".stl", ".3mf")
"""Endings of models for printing."""
SIZE, BASE = 150.0, 3.0
"""Default size of a model: millimetres of its longer side, and from the plate to the lowest ground."""
APART = 0.01
"""Parts that meet in a vertex are separated by this part of the way to a triangle's middle."""
LINES = 100_000
"""Lines of text formatted at once."""


@dataclass(frozen=True, slots=True)
class Print:
    """The dimensions of a model.

    Attributes:
        base: millimetres from the plate to the lowest ground. size: of the longer side. scale: instead: the N of 1:N.
        exaggeration: of heights.
    """

    base: float = BASE
    size: float | None = None
    scale: float | None = None
    exaggeration: float = 1.0

    def __post_init__(self) -> None:
        if self.size is not None and self.scale is not None:
            raise UsageError("`model_size` and `scale` say the same twice: give one of them.")
        for name, value in (("base", self.base), ("model_size", self.size), ("scale", self.scale)):
            if value is not None and not 0 < value < 1e9:
                raise UsageError(f"`{name}` must be more than 0, not {value:g}.")


@dataclass(frozen=True, slots=True)
class Solid:
    """A closed surface.

    Attributes:
        vertices: (n, 3) float64 millimetres, x east, y north, z up from the plate. triangles: (m, 3), counter-clockwise
            from outside. scale: the N of 1:N.
    """

    vertices: Array
    triangles: Triangles
    scale: float

    @property
    def size(self) -> tuple[float, float, float]:
        """Millimetres along x, y and z."""
        x, y, z = np.ptp(self.vertices, axis=0).tolist()
        return x, y, z

    @property
    def volume(self) -> float:
        """Cubic millimetres (by the divergence theorem)."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def solid(positions: Array, triangles: Triangles, how: Print) -> Solid:
    """Turn a mesh, positions (n, 3) in metres and triangles (m, 3), into a solid for printing.

    Raises:
        NothingInViewError: the mesh has no triangles.
    """
    if not len(triangles):
        raise NothingInViewError("The mesh has no triangles, so there is nothing to print.")
    ground, top = _apart(positions, triangles)
    low, high = ground.min(0), ground.max(0)
    scale = how.scale or 1000.0 * float((high - low)[:2].max()) / (how.size or SIZE)
    ground = (ground - low) * (1000.0 / scale)
    ground[:, 2] = how.base + how.exaggeration * ground[:, 2]
    plate = ground * [1.0, 1.0, 0.0]
    n = len(ground)
    begin, end = _border(top)
    walls = [[end, begin, begin + n], [end, begin + n, end + n]]
    faces = [top, top[:, ::-1] + n, *(np.stack(one, -1) for one in walls)]
    return Solid(np.concatenate([ground, plate]), np.concatenate(faces).astype(np.int32), scale)


def _border(triangles: Triangles) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges (from, to) that belong to only one triangle, in its orientation."""
    begin, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel().astype(np.int64)
    alone = ~np.isin(begin << 32 | end, end << 32 | begin)
    return begin[alone], end[alone]


def _apart(positions: Array, triangles: Triangles) -> tuple[Array, Triangles]:
    """Positions and triangles in which vertices shared by several parts of the ground are duplicated, one per part."""
    begin, _ = _border(triangles)
    vertices, number = np.unique(begin, return_counts=True)
    used, where = np.unique(triangles, return_inverse=True)
    positions, triangles = positions[used], where.reshape(triangles.shape).astype(np.int32)
    own = triangles.copy()
    more: list[Array] = []
    for vertex in np.searchsorted(used, vertices[number > 1]).tolist():
        for turn, fan in enumerate(_fans(triangles, vertex)):
            middle = positions[triangles[fan[len(fan) // 2]]].mean(0)
            name = vertex if turn == 0 else len(positions) + len(more)
            if turn:
                more.append(positions[vertex] + APART * (middle - positions[vertex]))
            own[fan] = np.where(triangles[fan] == vertex, name, own[fan])
    return np.concatenate([positions, *([more] if more else [])]), own


def _fans(triangles: Triangles, vertex: int) -> list[list[int]]:
    """The triangles around a vertex, part by part, in order."""
    around = np.flatnonzero((triangles == vertex).any(1)).tolist()
    turned = {}
    for t in around:
        at = triangles[t].tolist().index(vertex)
        turned[t] = int(triangles[t][at - 2]), int(triangles[t][at - 1])  # the corners after the vertex
    after = {out: t for t, (out, _) in turned.items()}
    inner = {into for _, into in turned.values()}
    fans = []
    for t in [t for t, (out, _) in turned.items() if out not in inner]:
        fan = [t]
        while turned[fan[-1]][1] in after:
            fan.append(after[turned[fan[-1]][1]])
        fans.append(fan)
    return fans


def write_solid(made: Solid, path: Path, name: str) -> Path:
    """Write a solid: .stl (binary) or .3mf.

    Raises:
        OutputError: the file cannot be written.
    """
    with Beside(path) as part:
        if path.suffix.lower() == ".stl":
            _stl(made.vertices, made.triangles, f"Orograph, millimetres, 1:{made.scale:.0f}", part)
        else:
            _3mf(made, part, name)
    return path


def write_surface(positions: Array, triangles: Triangles, path: Path, origin: Origin) -> tuple[float, float, float]:
    """Write a mesh as it is, open, in metres relative to an origin, which is returned: .stl (binary).

    Raises:
        UsageError: see ``origin_of``. OutputError: the file cannot be written.
    """
    start = origin_of(origin, positions)
    with Beside(path) as part:
        words = "Orograph, metres from {:.10g} {:.10g} {:.10g}".format(*start)
        _stl(positions - start, triangles, words, part)
    return start


def _stl(vertices: NDArray[np.float64], triangles: Triangles, words: str, part: Path) -> None:
    corners = vertices.astype(np.float32)[triangles]
    u, v = (corners[:, k].astype(np.float64) - corners[:, 0] for k in (1, 2))
    normal = np.cross(u, v)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    facets["normal"], facets["corners"] = normal / np.where(length > 0, length, 1), corners
    with part.open("wb") as file:
        file.write(words.encode()[:80].ljust(80))
        file.write(struct.pack("<I", len(facets)))
        file.write(facets.tobytes())


_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)


def _3mf(made: Solid, part: Path, name: str) -> None:
    from xml.sax.saxutils import quoteattr  # late, for it loads what talks to servers

    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as file:
        file.writestr("[Content_Types].xml", _TYPES)
        file.writestr("_rels/.rels", _RELATIONS)
        with file.open("3D/3dmodel.model", "w", force_zip64=True) as model:
            model.write(
                '<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en" '
                'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
                f'<metadata name="Application">Orograph</metadata>\n<resources><object id="1" type="model" '
                f"name={quoteattr(name)}><mesh>\n<vertices>\n".encode()
            )
            for pattern, rows, close in (
                ('<vertex x="%.5f" y="%.5f" z="%.5f"/>\n', made.vertices, "</vertices>\n<triangles>\n"),
                ('<triangle v1="%d" v2="%d" v3="%d"/>\n', made.triangles, "</triangles>\n"),
            ):
                for first in range(0, len(rows), LINES):
                    block = rows[first : first + LINES]
                    model.write((pattern * len(block) % tuple(block.ravel().tolist())).encode())
                model.write(close.encode())
            model.write(b'</mesh></object></resources>\n<build><item objectid="1"/></build>\n</model>\n')
