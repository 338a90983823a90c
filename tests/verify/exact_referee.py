"""What the referee should say, the slow way: exact fractions, every pair, the view's own projection and planes."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from broken_meshes import Corner, Triangle, area, share_area, units

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
    for plane in view.frustum(exaggeration):
        kept = []
        for j, p in enumerate(polygon):
            q = polygon[(j + 1) % len(polygon)]
            sp, sq = plane @ p, plane @ q
            if sp > 1e-7:
                kept.append(p)
            if (sp > 1e-7) != (sq > 1e-7):
                kept.append(p + (q - p) * (sp - 1e-7) / (sp - sq))
        polygon = kept
        if not polygon:
            return False
    return True


def height(t: Triangle, z: list[float], p: Corner) -> float:
    """The height of a triangle's plane, by exact barycentric weights."""
    weights = [Fraction(area((p, t[(i + 1) % 3], t[(i + 2) % 3])), area(t)) for i in range(3)]
    return float(sum(w * Fraction(v) for w, v in zip(weights, z)))


def beyond(a: Corner, b: Corner, side: int) -> list[Point]:
    """Points just beside an edge, one for each unit triangle that it runs through or along on that side."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    cuts = {Fraction(0), Fraction(1)}
    for origin, step in ((a[0], dx), (a[1], dy), (a[0] + a[1], dx + dy), (a[0] - a[1], dx - dy)):
        for k in range(min(origin, origin + step), max(origin, origin + step) + 1):
            if step:
                cuts.add(Fraction(k - origin, step))
    ordered = sorted(cuts)
    tiny = Fraction(side, 10**9)
    return [(a[0] + (s + t) / 2 * dx - tiny * dy, a[1] + (s + t) / 2 * dy + tiny * dx)
            for s, t in pairwise(ordered)]  # fmt: skip


def judge(mesh: Tessellation, terrain: MemoryTerrain, view: View, exaggeration: float = 1.0) -> dict[str, Any]:
    """The numbers of a ``Report``; ``overlapping`` is the set of triangles that overlap."""
    heights = terrain.heights
    rows, cols = heights.shape
    place = [(int(c), int(r)) for c, r, _ in mesh.vertices]
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
    return {
        "samples": samples,
        "largest": max(errors.values(), default=0.0),
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
        "wrong_heights": sum(mesh.vertices[v, 2] != heights[place[v][1], place[v][0]] for v in used),
        **{k: kinds[k] for k in ("border", "rim_of_missing", "rim_of_culled", "inner")},
    }
