"""SOAR: one recursive pass without state over nested spheres, one generalised triangle strip out.

Lindstrom & Pascucci, *Visualization of Large Terrains Made Easy* (Vis 2001) and *Terrain Simplification Simplified* (TVCG
2002). A diamond is *active* if the bound of its error over its sphere exceeds the tolerance and the sphere is in view.
Errors are monotonic and spheres nested, so a diamond's parents are active when it is: both triangles that share a
diamond decide alike, wherever they are met, and the mesh conforms without neighbours, queues or state. The pass goes
through the leaves in the order of a Sierpinski curve, in which each shares an edge with the next: a strip.

What differs from the papers: the strip is grown leaf by leaf (each new vertex lies opposite the edge that the leaf
shares with the last one; a repeated vertex turns the strip where the curve turns), because leaves can be missing:
subtrees out of view and holes are left out, and the strip is taken up again behind them. The metric holds away from the
image centre. Geomorphs (2002, sec. 5.3): a vertex that has just become necessary starts on its parents' edge and
reaches its height when the bound of its error has doubled; all surfaces between keep the tolerance.

The recursion is a flat stack in a kernel; subtrees can be given to several threads, and their strips follow each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.error.screen import color_exceeds, outside, sphere_bound, sphere_exceeds, to_camera
from orograph.lod.engine import Engine, Mesh, by_tolerance, join
from orograph.lod.field import find
from orograph.parallel import map_ordered
from orograph.view import View


@leaf
def refine_subtree(
    pages, lens, metric, cull, morph, level0, corners, heights, inside0, leaf_level, stack, stack_z, keys, zs, counts
):
    """Refine one triangle and append its strip.

    Args:
        pages: ``field.Pages``. lens: the camera. metric: its number.
        cull: whether what is out of view is left out.
        morph: whether vertices morph: activity begins at half the tolerance.
        level0: the triangle's level.
        corners: int64 (3, 2), (row, col) of the hypotenuse's first end, its last end, and the apex.
        heights: float32 (3,), theirs, NaN where missing.
        inside0: bits of the planes that the triangle is known to be inside of.
        leaf_level: 2n.
        stack: int64 (2n + 1, 8), stack_z: float32 (2n + 1, 3), for the triangles that wait.
        keys: int64 (capacity,), the strip's vertices, row << 32 | col of the padded square.
        zs: float32 (capacity,), their heights.
        counts: int64 (3,): strip length, triangles, nodes visited; length −1 if the capacity did not suffice.
    """
    n = leaf_level >> 1
    stretch = lens[15]
    capacity = len(keys) - 8
    length = 0
    triangles = 0
    nodes = 0
    # The last triangle's edge to go on from (p, q), and its newest vertex v, which is not written yet.
    p = q = v = np.int64(-1)
    pz = qz = vz = np.float32(0.0)
    is_open = False
    er, ec, ez = corners[0, 0], corners[0, 1], heights[0]
    xr, xc, xz = corners[1, 0], corners[1, 1], heights[1]
    ar, ac, az = corners[2, 0], corners[2, 1], heights[2]
    level = level0
    mask = inside0
    top = 0
    while True:
        nodes += 1
        keep = True
        if level < leaf_level:
            mr = (er + xr) >> 1
            mc = (ec + xc) >> 1
            slot, i, j = find(pages, mr, mc, n - 1 - (level >> 1))
            if slot >= 0:
                z = pages.data[slot, i, j, 0]
                e = np.float64(pages.data[slot, i, j, 1])
                r = np.float64(pages.data[slot, i, j, 2])
                c = np.float64(pages.data[slot, i, j, 3])
                col = np.float64(min(mc, pages.edge[1]))
                row = np.float64(min(mr, pages.edge[0]))
                if r < 0.0:
                    r = -r
                    keep = False
                r *= stretch
                out = False
                if cull:
                    out, mask = outside(lens, col, row, np.float64(z), r, mask)
                if out:
                    keep = False
                else:
                    x, y, w = to_camera(lens, col, row, np.float64(z))
                    missing = c < 0.0
                    if missing:
                        c = -1.0 - c
                    if sphere_exceeds(lens, metric, x, y, w, e, r) or color_exceeds(lens, c, w, r):
                        mz = np.float32(np.nan) if missing else z
                        if (
                            morph
                            and not missing
                            and e < np.inf
                            and mr + (1 << (n - 1 - (level >> 1))) <= pages.edge[0]
                            and mc + (1 << (n - 1 - (level >> 1))) <= pages.edge[1]
                        ):
                            # From half the tolerance (lens) to the whole.
                            t = sphere_bound(lens, metric, x, y, w, e, r) / lens[13] - 1.0
                            if t < 1.0 and not color_exceeds(lens, c, w, r):
                                mz = np.float32((1.0 - t) * 0.5 * (np.float64(ez) + np.float64(xz)) + t * z)
                        # The second child waits; the first is next.
                        stack[top, 0], stack[top, 1], stack_z[top, 0] = ar, ac, az
                        stack[top, 2], stack[top, 3], stack_z[top, 1] = xr, xc, xz
                        stack[top, 4], stack[top, 5], stack_z[top, 2] = mr, mc, mz
                        stack[top, 6], stack[top, 7] = level + 1, mask
                        top += 1
                        xr, xc, xz = ar, ac, az
                        ar, ac, az = mr, mc, mz
                        level += 1
                        continue
        if keep and ez == ez and xz == xz and az == az:
            if length > capacity:
                length = -1
                break
            ek = er << 32 | ec
            xk = xr << 32 | xc
            ak = ar << 32 | ac
            if is_open:
                # The next triangle has v and p or q.
                to_q = q == ek or q == xk or q == ak
                to_v = v == ek or v == xk or v == ak
                to_p = p == ek or p == xk or p == ak
                if to_v and (to_q or to_p):
                    if not to_q:
                        keys[length], zs[length] = p, pz
                        length += 1
                        q, qz = p, pz
                    keys[length], zs[length] = v, vz
                    length += 1
                    p, pz, q, qz = q, qz, v, vz
                    if ek != p and ek != q:
                        v, vz = ek, ez
                    elif xk != p and xk != q:
                        v, vz = xk, xz
                    else:
                        v, vz = ak, az
                    triangles += 1
                else:
                    keys[length], zs[length] = v, vz
                    length += 1
                    is_open = False
            if not is_open:
                # A new strip begins with (apex, first end, last end) in the winding of all leaves of this level.
                odd = (level - level0) & 1 == 1
                if length:
                    keys[length], zs[length] = keys[length - 1], zs[length - 1]
                    keys[length + 1], zs[length + 1] = ak, az
                    length += 2
                    if length & 1:
                        keys[length], zs[length] = ak, az
                        length += 1
                if odd:
                    # the mirror image: a vertex more turns the winding
                    keys[length], zs[length] = ak, az
                    length += 1
                keys[length], zs[length] = ak, az
                keys[length + 1], zs[length + 1] = ek, ez
                length += 2
                p, pz, q, qz, v, vz = ak, az, ek, ez, xk, xz
                is_open = True
                triangles += 1
        elif is_open:
            keys[length], zs[length] = v, vz
            length += 1
            is_open = False
        if top == 0:
            break
        top -= 1
        er, ec, ez = stack[top, 0], stack[top, 1], stack_z[top, 0]
        xr, xc, xz = stack[top, 2], stack[top, 3], stack_z[top, 1]
        ar, ac, az = stack[top, 4], stack[top, 5], stack_z[top, 2]
        level, mask = stack[top, 6], stack[top, 7]
    if is_open and length >= 0:
        keys[length], zs[length] = v, vz
        length += 1
    counts[0] = length
    counts[1] = triangles
    counts[2] = nodes


class Soar(Engine):
    """SOAR. See ``Engine`` for the arguments; besides:

    Args:
        geomorph: vertices morph between half the tolerance and the whole (errors stay within the tolerance).
    """

    name = "soar"
    metrics = ("anisotropic", "isotropic", "isotropic-published")

    def __init__(self, *args: Any, geomorph: bool = False, **options: Any) -> None:
        super().__init__(*args, **options)
        self.geomorph = geomorph
        self._capacity = 1 << 16

    def _refine(self, view: View, tolerance: float | None, triangles: int | None, seconds: float | None) -> Mesh:
        if tolerance is None:
            return by_tolerance(self, view, triangles, seconds)
        lens = self._lens(view, tolerance * (0.5 if self.geomorph else 1.0))
        parts = self._subtrees()
        while True:
            self.field.begin()
            found = list(map_ordered(lambda part: self._strip(lens, *part), parts, self.jobs))
            if not self.field.fetch():
                break
        keys, zs = join([(k, z) for k, z, _, _ in found])
        return Mesh(
            keys, zs, is_strip=True, clockwise=False, triangles=sum(t for _, _, t, _ in found),
            stats={"nodes": sum(nodes for *_, nodes in found), "geomorph": self.geomorph},
        )  # fmt: skip

    def _subtrees(self) -> list[tuple[int, NDArray[np.int64], NDArray[np.float32]]]:
        """The roots, or for several threads the triangles some levels below them, in the strip's order."""
        size = 1 << self.field.n
        nw, ne, sw, se = (0, 0), (0, size), (size, 0), (size, size)
        z = self.field.corners
        todo = [((nw, se, ne), (z[0, 0], z[1, 1], z[0, 1])), ((se, nw, sw), (z[1, 1], z[0, 0], z[1, 0]))]
        return [(0, np.array(c, np.int64), np.array(h, np.float32)) for c, h in todo]

    def _strip(
        self, lens: NDArray[np.float64], level: int, corners: NDArray[np.int64], heights: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], int, int]:
        counts = np.zeros(3, np.int64)
        stack = np.empty((2 * self.field.n + 1, 8), np.int64), np.empty((2 * self.field.n + 1, 3), np.float32)
        while True:
            keys, zs = np.empty(self._capacity, np.int64), np.empty(self._capacity, np.float32)
            refine_subtree(
                self.field.pages, lens, self.metric.number, self.cull, self.geomorph, level, corners, heights, 0,
                2 * self.field.n, *stack, keys, zs, counts,
            )  # fmt: skip
            if counts[0] >= 0:
                return keys[: counts[0]], zs[: counts[0]], int(counts[1]), int(counts[2])
            self._capacity *= 2
