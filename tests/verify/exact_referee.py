"""What the referee should say, the slow way: exact fractions, every pair, the view's own projection and planes.

The largest error between samples is looked for on every polygon that a triangle, a unit triangle and the frustum share:
at its corners, at random points of its inside, and along its sides at many points, about the best of which a numerical
search goes on.
"""

from __future__ import annotations

import math
from collections import Counter
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from broken_meshes import Corner, Triangle, area, exact, share_area, units
from scipy.optimize import minimize_scalar

from orograph.store import MemoryTerrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

Point = tuple[Fraction, Fraction]


def clip(polygon: list[Any], t: Triangle) -> list[Any]:
    """The part of a convex polygon inside a triangle (Sutherland & Hodgman), exact."""
    sign = 1 if area(t) > 0 else -1
    for i in range(3):
        (ax, ay), (bx, by) = t[i], t[(i + 1) % 3]
        kept = []
        for j, p in enumerate(polygon):
            q = polygon[(j + 1) % len(polygon)]
            sp = sign * ((bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax))
            sq = sign * ((bx - ax) * (q[1] - ay) - (by - ay) * (q[0] - ax))
            if sp >= 0:
                kept.append(p)
            if sp * sq < 0:
                f = Fraction(sp) / (sp - sq)
                kept.append((p[0] + f * (q[0] - p[0]), p[1] + f * (q[1] - p[1])))
        polygon = kept
        if not polygon:
            break
    return polygon


def shared_area(s: Triangle, t: Triangle) -> Fraction:
    """Area that two triangles share."""
    if not share_area(s, t):
        return Fraction(0)
    p = clip(list(s), t)
    twice = sum((p[i - 1][0] * p[i][1] - p[i][0] * p[i - 1][1] for i in range(len(p))), Fraction(0))
    return abs(twice) / 2


def contains(t: Triangle, p: Any) -> bool:
    """Whether a point lies in a closed triangle."""
    s = [(t[(i + 1) % 3][0] - t[i][0]) * (p[1] - t[i][1]) - (t[(i + 1) % 3][1] - t[i][1]) * (p[0] - t[i][0])
         for i in range(3)]  # fmt: skip
    return min(s) >= 0 or max(s) <= 0


def in_view(terrain: MemoryTerrain, t: tuple[Corner, ...], view: View, exaggeration: float) -> bool:
    """Whether a polygon of samples reaches into the frustum, clipped by the view's own planes."""
    x, y = terrain.grid.xy([p[0] for p in t], [p[1] for p in t])
    z = [float(terrain.heights[p[1], p[0]]) * exaggeration for p in t]
    polygon = [np.array([*p, 1.0]) for p in zip(x, y, z)]
    return bool(cut_by_planes(polygon, view.frustum(exaggeration), 1e-7))


def cut_by_planes(polygon: list[Any], planes: Any, margin: float) -> list[Any]:
    """The part of a convex polygon of points (x, y, z, 1) that is more than a margin inside all planes."""
    for plane in planes:
        kept = []
        for j, p in enumerate(polygon):
            q = polygon[(j + 1) % len(polygon)]
            sp, sq = plane @ p, plane @ q
            if sp > margin:
                kept.append(p)
            if (sp > margin) != (sq > margin):
                kept.append(p + (q - p) * (sp - margin) / (sp - sq))
        polygon = kept
        if not polygon:
            break
    return polygon


def height(t: Triangle, z: list[float], p: Corner) -> float:
    """The height of a triangle's plane, by exact barycentric weights."""
    weights = [Fraction(area((p, t[(i + 1) % 3], t[(i + 2) % 3]))) / area(t) for i in range(3)]
    return float(sum(w * Fraction(v) for w, v in zip(weights, z)))


def beyond(a: Corner, b: Corner, side: int) -> list[Point]:
    """Points just beside an edge, one for each unit triangle that it runs through or along on that side."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    cuts = {Fraction(0), Fraction(1)}
    for origin, step in ((a[0], dx), (a[1], dy), (a[0] + a[1], dx + dy), (a[0] - a[1], dx - dy)):
        for k in range(math.ceil(min(origin, origin + step)), math.floor(max(origin, origin + step)) + 1):
            if step:
                cuts.add(Fraction(k - origin) / step)
    ordered = sorted(cuts)
    tiny = Fraction(side, 10**9)
    return [(a[0] + (s + t) / 2 * dx - tiny * dy, a[1] + (s + t) / 2 * dy + tiny * dx)
            for s, t in pairwise(ordered)]  # fmt: skip


def largest_on_surface(
    mesh: Tessellation, triangles: list[Any], solid: list[int], terrain: MemoryTerrain, view: View, exaggeration: float
) -> tuple[float, float]:
    """Pixels, the largest over all points of the full-resolution surface in view; and metres to the nearest point."""
    inverse = ~terrain.grid.transform
    rng = np.random.default_rng(0)
    frustum = view.frustum(exaggeration)
    largest, nearest = 0.0, math.inf
    eye = np.multiply(view.eye, [1.0, 1.0, exaggeration])
    for unit, exists in units(terrain.heights).values():
        if not exists:
            continue
        ground = np.array([(*terrain.grid.xy(c, r), terrain.heights[r, c]) for c, r in unit], np.float64)
        for k in solid:
            if not share_area(unit, triangles[k]):
                continue
            piece = [(float(x), float(y)) for x, y in clip(list(unit), triangles[k])]
            corners = mesh.vertices[mesh.triangles[k]]
            tilt = np.linalg.solve(np.column_stack([corners[:, :2], np.ones(3)]), corners[:, 2])
            weights = np.linalg.solve(
                np.vstack([np.transpose(unit).astype(float), np.ones(3)]),
                np.vstack([np.transpose(piece), np.ones(len(piece))]),
            )
            polygon = [np.array([*p[:2], p[2] * exaggeration, 1.0]) for p in weights.T @ ground]
            polygon = cut_by_planes(polygon, frustum, 0.0)
            if not polygon:
                continue

            def pixels(points: Any, tilt: Any = tilt) -> Any:
                """Of points (…, 3) of the ground in stretched space."""
                p = np.asarray(points) / [1.0, 1.0, exaggeration]
                c, r = inverse @ (p[..., 0], p[..., 1])
                up = np.stack([p[..., 0], p[..., 1], tilt[0] * (c - 0.5) + tilt[1] * (r - 0.5) + tilt[2]], -1)
                distance = np.hypot(
                    *np.moveaxis(view.project(up, exaggeration)[0] - view.project(p, exaggeration)[0], -1, 0)
                )
                return np.where(np.isfinite(distance), distance, np.inf)

            shape = np.array(polygon)[:, :3]
            inside = rng.dirichlet(np.ones(len(shape)), 20) @ shape
            largest = max(largest, float(pixels(shape).max()), float(pixels(inside).max()))
            steps = np.linspace(0, 1, 33)
            sides = shape[:, None] + steps[:, None] * (np.roll(shape, -1, 0) - shape)[:, None]
            nearest = min(nearest, float(np.linalg.norm(sides - eye, axis=-1).min()))
            for p, q in zip(shape, np.roll(shape, -1, 0)):
                values = pixels(p + steps[:, None] * (q - p))
                best = int(values.argmax())
                if np.isfinite(values).all() and 0 < best < 32 and values[best] > 0.9 * largest:
                    found = minimize_scalar(
                        lambda s, p=p, q=q: -float(pixels(p + s * (q - p))), method="bounded",
                        bounds=(steps[best - 1], steps[best + 1]), options={"xatol": 1e-10},
                    )  # fmt: skip
                    largest = max(largest, -found.fun)
                largest = max(largest, float(values.max()))
    return largest, nearest


def judge(mesh: Tessellation, terrain: MemoryTerrain, view: View, exaggeration: float = 1.0) -> dict[str, Any]:
    """The numbers of a ``Report``; ``overlapping`` is the set of triangles that overlap, ``rounding`` (px) what
    floating-point coordinates make uncertain at the nearest point."""
    heights = terrain.heights
    rows, cols = heights.shape
    place = [(exact(c), exact(r)) for c, r, _ in mesh.vertices]
    triangles: list[Any] = [tuple(place[i] for i in t) for t in mesh.triangles]
    z = [[float(mesh.vertices[i, 2]) for i in t] for t in mesh.triangles]
    sign = 1 if terrain.grid.transform.determinant > 0 else -1
    turns = [np.sign(area(t)) * sign for t in triangles]
    solid = [k for k, s in enumerate(turns) if s]
    ground = units(heights)
    errors, uncovered, samples = {}, 0, 0
    planes = view.frustum(exaggeration)
    for r in range(rows):
        for c in range(cols):
            if not any(exists and (c, r) in t for t, exists in ground.values()):
                continue
            x, y = (float(v) for v in terrain.grid.xy(c, r))
            h = float(heights[r, c])
            if (planes @ [x, y, h * exaggeration, 1.0] < 0).any():
                continue
            samples += 1
            on = [height(triangles[k], z[k], (c, r)) for k in solid if contains(triangles[k], (c, r))]
            uncovered += not on
            for v in on:
                at, _ = view.project([[x, y, h], [x, y, v]], exaggeration)
                pixels = float(np.hypot(*(at[1] - at[0])))
                errors[c, r] = max(errors.get((c, r), 0.0), pixels if np.isfinite(pixels) else np.inf)
    holes = bridged = 0
    for t, exists in ground.values():
        covered = sum((shared_area(t, triangles[k]) for k in solid), Fraction(0))
        bridged += not exists and covered > 0
        if exists and covered < Fraction(1, 2):  # assumes that triangles do not overlap within a unit
            holes += in_view(terrain, t, view, exaggeration)
    overlapping = {k for k in solid for j in solid if j != k and share_area(triangles[j], triangles[k])}
    edges = Counter(frozenset((int(t[i]), int(t[(i + 1) % 3]))) for t in mesh.triangles for i in range(3))
    kinds: Counter[str] = Counter()
    for k in solid:
        for i in range(3):
            v, w, u = (int(mesh.triangles[k, (i + j) % 3]) for j in range(3))
            if edges[frozenset((v, w))] != 1:
                continue
            side = -1 if area((place[v], place[w], place[u])) > 0 else 1
            kind = "border"
            for p in beyond(place[v], place[w], side):
                if any(contains(triangles[j], p) for j in solid):
                    kind = "inner"
                for t, exists in ground.values():
                    if contains(t, p):
                        seen = exists and in_view(terrain, t, view, exaggeration)
                        here = "inner" if seen else "rim_of_culled" if exists else "rim_of_missing"
                        kind = max(kind, here, key=["border", "rim_of_missing", "rim_of_culled", "inner"].index)
            kinds[kind] += 1
    used = {int(i) for k in solid for i in mesh.triangles[k]}
    junctions = set()
    for v in used:
        for k in solid:
            for i in range(3):
                a, b = triangles[k][i], triangles[k][(i + 1) % 3]
                p = place[v]
                dot = (p[0] - a[0]) * (b[0] - p[0]) + (p[1] - a[1]) * (b[1] - p[1])
                if area((a, b, p)) == 0 and dot > 0:
                    junctions.add(p)
    largest, nearest = largest_on_surface(mesh, triangles, solid, terrain, view, exaggeration)
    rounding = 1e-8 / view.pixel_slope / nearest  # 1e-8 m: some 20 units in the last place of a northing
    return {
        "samples": samples,
        "largest": max(largest, *errors.values(), 0.0),  # a triangle may touch the surface in a sample alone
        "rounding": 1e-6 + rounding,
        "largest_at_samples": max(errors.values(), default=0.0),
        "rms": float(np.sqrt(np.mean([e * e for e in errors.values()]))) if errors else 0.0,
        "uncovered": uncovered,
        "holes": holes,
        "bridged": bridged,
        "t_junctions": len(junctions),
        "overlapping": overlapping,
        "crowded": sum(n > 2 for n in edges.values()),
        "reversed": turns.count(-1),
        "flat": turns.count(0),
        "duplicates": len(used) - len({place[v] for v in used}),
        "wrong_heights": sum(
            mesh.vertices[v, 2] != heights[place[v][1], place[v][0]]
            for v in used
            if isinstance(place[v][0], int) and isinstance(place[v][1], int)
        ),
        **{k: kinds[k] for k in ("border", "rim_of_missing", "rim_of_culled", "inner")},
    }
