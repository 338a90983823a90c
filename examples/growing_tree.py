"""A tree on the GPU as it grows from two triangles: python examples/growing_tree.py DEM OUT.jpg [UPDATES…]"""

from __future__ import annotations

import sys

from PIL import Image

from orograph import verify
from orograph.gpu.device import open_device
from orograph.lod.field import Vertices
from orograph.lod.triangle_patches import TrianglePatches
from orograph.rendering.comparison import Panel, panel_view, sheet
from orograph.rendering.gpu.stream.diamonds import DiamondPages
from orograph.rendering.gpu.surface.tree import Tree
from orograph.scene.camera import around
from orograph.store.prepare import prepare
from orograph.viewpoint import Camera

TOLERANCE = 1.0


def main(dem: str, out: str, *updates: str) -> None:
    device, terrain = open_device(), prepare([dem])
    counts = [int(count) for count in updates] or [8, 16, 24, 40]
    view = panel_view(around(terrain, (1280, 560), azimuth=180, pitch=35, distance=None), len(counts))
    vertices = Vertices(terrain)
    pages = DiamondPages(device, vertices, 256 << 20)
    tree = Tree(device, terrain, vertices.corners, pages, 1 << 17)
    patches = TrianglePatches(terrain).patches(Camera.over(terrain.grid, view, 1.0), TOLERANCE)
    pages.load(view, patches, TOLERANCE, 1.0)
    panels, done = [], 0
    for count in counts:
        tree.update(view, TOLERANCE, 1.0, count - done)
        done, mesh = count, tree.tessellation({})
        largest = verify.judge_mesh(mesh, terrain, view).largest_at_samples
        said = f"after {count} updates: {len(mesh.triangles):,} triangles", f"largest error {largest:.2g} px"
        panels.append(Panel("cbt", mesh, said))
    note = (
        f"{terrain.name}: the tree of a view, tolerance {TOLERANCE:g} px; errors are the referee's, at samples in view."
    )
    Image.fromarray(sheet(terrain, view, panels, title="A tree grows", note=note)).save(out, quality=85)
    pages.close()


main(*sys.argv[1:])
