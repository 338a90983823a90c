"""QuadTIN refined where triangles would change colours: errors against all samples, and the tolerance on a view."""

from __future__ import annotations

import numpy as np
import plain
import pytest
from painted import Painted, off_in

from orograph import verify
from orograph.errors import UsageError
from orograph.lod.method import Goal, Resources
from orograph.lod.registry import chosen
from orograph.scene.camera import around, whole
from orograph.viewpoint import Camera


@pytest.mark.stress
def test_color_errors_are_those_of_all_samples_and_saturated():
    t = plain.terrain(plain.rough(np.random.default_rng(31), (70, 90)))
    painted = Painted((70, 90))
    method = chosen("quadtin,color-tolerance=5").make(t, Resources(color=painted))
    tree, found = method.tree, method._colors
    own = np.zeros((len(tree.vertices), 3))
    for node, corners in zip(tree.node, tree.corners):
        if node >= 0:
            own[node] = np.maximum(own[node], off_in(tree.vertices[corners, :2], painted.lab))
    bare = np.sqrt((own**2).sum(1))
    assert (found >= bare - 1e-4).all() and np.isclose(found.max(), bare.max(), atol=1e-4)
    for v in range(4, len(found)):
        assert (found[tree.parents[v]] >= found[v]).all()
        below = [found[u] for u in tree.nodes[v] if u >= 0]
        assert found[v] == pytest.approx(max([bare[v], *below]), abs=1e-4)


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["quadtin", "hyperblock,cells=8"])
def test_colors_are_kept_down_to_the_finest_triangles(name):
    t = plain.terrain(plain.rough(np.random.default_rng(32), (129, 129)))
    painted, view = Painted((129, 129)), whole(t, (1600, 1200))
    counts = []
    for gamma in (40.0, 15.0, 6.0):
        method = chosen(f"{name},color-tolerance={gamma}").make(t, Resources(color=painted))
        found = method.refined(Camera.over(t.grid, view), Goal(500.0))
        counts.append(found.triangles)
        for leaf in found.leaves:
            if method.tree.node[leaf] >= 0:
                off = off_in(method.tree.vertices[method.tree.corners[leaf], :2], painted.lab)
                assert np.sqrt((off**2).sum()) <= gamma + 1e-4
        mesh = method.select(Camera.over(t.grid, view), Goal(500.0)).tessellation()
        assert verify.judge_mesh(mesh, t, view).defects == {}
    assert counts[0] < counts[1] < counts[2]
    with pytest.raises(UsageError, match="needs colours"):
        chosen(f"{name},color-tolerance=2").make(t)


def test_blocks_are_as_fine_as_single_vertices_where_colors_ask_for_it():
    """From near and far, and on flat ground, whose heights ask for nothing: all that QuadTIN splits, blocks split."""
    z = plain.rough(np.random.default_rng(33), (97, 129))
    z[:, 60:] = 500.0
    t, painted = plain.terrain(z), Painted((97, 129))
    single, blocks = (
        chosen(f"{name},cull=no,color-tolerance=8").make(t, Resources(color=painted))
        for name in ("quadtin", "hyperblock,cells=8,levels=1")
    )
    plainly = chosen("hyperblock,cells=8,levels=1,cull=no").make(t)
    more = []
    for away in (0.6, 2.0, 8.0, 40.0):
        camera = Camera.over(
            t.grid, around(t, (400, 300), pitch=30, azimuth=40, distance=away * 129 * t.grid.spacing[0])
        )
        needed, made, bare = (method.refined(camera, Goal(2.0)) for method in (single, blocks, plainly))
        corners = [np.unique(m.tree.corners[r.leaves]) for m, r in ((single, needed), (blocks, made))]
        assert np.isin(*corners).all()
        more.append(made.triangles - bare.triangles)
    assert min(more) > 0 and made.triangles < 1.5 * needed.triangles
