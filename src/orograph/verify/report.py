"""The referee's report: numbers, the places of the worst, and whether the promise holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

Place = tuple[float, float]
"""(column, row) on the raster; whole numbers are int."""

ROUNDING = 1e-7
"""Relative excess over a tolerance that is attributed to rounding: 1e-11 m, a metre before the eye, are 1e-8 pixels."""


def place(column: float, row: float) -> Place:
    """A place, of any kind of numbers."""
    column, row = float(column), float(row)
    return int(column) if column.is_integer() else column, int(row) if row.is_integer() else row


@dataclass(frozen=True, slots=True)
class Report:
    """The verdict on a tessellation of a terrain in a view.

    Attributes:
        triangles, vertices: of the mesh.
        samples: full-resolution samples in view: inside the frustum, and on at least one existing unit triangle.
        largest: the largest distance in pixels between a point of the full-resolution surface in view and the mesh on
            its vertical.
        worst: (column, row) of that point; None if nothing in view is covered.
        largest_at_samples, worst_sample: the same over samples alone.
        rms: root of the mean square of the distance, over the samples in view that are covered.
        uncovered: samples in view that lie on no triangle.
        holes: unit triangles of the full-resolution surface, at least partly in view, that the mesh does not cover, or
            only in part.
        bridged: missing unit triangles that the mesh covers wholly or in part.
        t_junctions: vertices that lie inside an edge of a triangle.
        overlaps: triangles found to share area with another; 0 iff there are none (in a stack of several, some may be
            missed).
        crowded: edges of more than two triangles.
        reversed: triangles that turn clockwise from above in map orientation.
        flat: triangles without area.
        duplicates: vertices at the place of another.
        wrong_heights: vertices on samples whose height is not exactly the raster's, unless heights are free; and any
            that are not finite.
        border, rim_of_missing, rim_of_culled: legitimate open edges (with one triangle): at the raster's border, beside
            missing ground, beside ground that is out of view.
        inner: the other open edges: ground in view lies beyond them, or another triangle that does not share the edge.
        places: (column, row) of the first of each kind of defect that was found.
    """

    triangles: int
    vertices: int
    samples: int
    largest: float
    worst: Place | None
    largest_at_samples: float
    worst_sample: Place | None
    rms: float
    uncovered: int
    holes: int
    bridged: int
    t_junctions: int
    overlaps: int
    crowded: int
    reversed: int
    flat: int
    duplicates: int
    wrong_heights: int
    inner: int
    border: int
    rim_of_missing: int
    rim_of_culled: int
    places: dict[str, Place] = field(default_factory=dict)

    @property
    def defects(self) -> dict[str, int]:
        """The defects of the mesh, which do not depend on the tolerance; empty for a valid one."""
        return {name: getattr(self, name) for name in DEFECTS if getattr(self, name)}

    def ok(self, tolerance: float = math.inf) -> bool:
        """Whether the mesh has no defect, and no surface point in view is more than ``tolerance`` pixels from it."""
        return not self.defects and self.largest <= tolerance * (1 + ROUNDING)

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON values; an infinite distance is None."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("largest", "largest_at_samples", "rms"):
            if not math.isfinite(values[name]):
                values[name] = None
        for name in ("worst", "worst_sample"):
            values[name] = None if values[name] is None else list(values[name])
        values["places"] = {name: list(place) for name, place in self.places.items()}
        return values

    def __str__(self) -> str:
        lines = [
            f"{self.triangles:,} triangles, {self.vertices:,} vertices; {self.samples:,} samples in view",
            f"error: {self.largest:.4g} px at most{_at(self.worst)}",
            f"at samples: {self.largest_at_samples:.4g} px at most{_at(self.worst_sample)}, {self.rms:.4g} px rms",
            f"open edges: {self.border:,} at the border, {self.rim_of_missing:,} beside missing ground, "
            f"{self.rim_of_culled:,} beside ground out of view",
        ]
        for name, count in self.defects.items():
            lines.append(f"DEFECT: {count:,} {DEFECTS[name]} (the first{_at(self.places[name])})")
        if not self.defects:
            lines.append("no defects")
        return "\n".join(lines)


def _at(where: Place | None) -> str:
    """A place in words."""
    return "" if where is None else f" at column {where[0]:.8g}, row {where[1]:.8g}"


DEFECTS = {
    "uncovered": "samples in view not covered",
    "holes": "unit triangles in view not wholly covered",
    "bridged": "missing unit triangles covered",
    "t_junctions": "T-junctions",
    "overlaps": "overlapping triangles",
    "crowded": "edges of more than two triangles",
    "reversed": "triangles that turn clockwise",
    "flat": "triangles without area",
    "duplicates": "vertices at the place of another",
    "wrong_heights": "vertices not at the raster's height",
    "inner": "open edges inside the mesh",
}
"""The counts that should be 0, and their names."""
