"""BDAM refined where its TINs would change colours: errors against all samples, and the tolerance on a view."""

from __future__ import annotations

import numpy as np
import plain
import pytest
from painted import Painted, off_in

from orograph import verify
from orograph.errors import UsageError
from orograph.hierarchy import diamonds
from orograph.lod import tin_colors
from orograph.lod.method import Goal, Resources
from orograph.lod.registry import chosen
from orograph.scene.camera import whole
from orograph.store.tin_diamonds import Workplace, tins_of
from orograph.viewpoint import Camera


def made(t, gamma, painted, legs=4):
    return chosen(f"bdam,legs={legs},cull=no,color-tolerance={gamma}").make(t, Resources(color=painted))


def off_of(mesh, lab):
    """How far off the colours of a mesh's triangles are, ΔE."""
    places, corners = mesh
    channels = np.array([off_in(places[t, :2], lab) for t in corners]).reshape(-1, 3).max(0, initial=0.0)
    return float(np.sqrt((channels**2).sum()))


def own_errors(method, lab):
    """By (row, col) of the diamonds with TINs, before they are made monotonic."""
    t, found, work = method.terrain, {}, Workplace()
    for k in range(method.legs.bit_length() - 1, t.n):
        for block in tin_colors.blocks_of(t, method.tins, k):
            for row, col in block.tolist():
                places, *patches = tins_of(t, method.tins, row, col, work)
                found[row, col] = off_of((places, np.concatenate([p.reshape(-1, 3) for p in patches])), lab)
    return found


@pytest.mark.parametrize(("shape", "gaps", "block"), [((33, 49), 0.0, 16), ((50, 37), 0.02, 512)])
def test_color_errors_are_those_of_all_samples_and_monotonic(monkeypatch, shape, gaps, block):
    monkeypatch.setattr(tin_colors, "BLOCK", block)
    t = plain.terrain(plain.rough(np.random.default_rng(41), shape, gaps=gaps))
    painted = Painted(shape)
    painted.lab[np.isnan(t.heights)] = np.nan
    method = made(t, 5, painted)
    tables = tin_colors.color_errors(t, method.tins, painted.colors, jobs=2)
    for level, table in enumerate(tables):
        read = method.field.vertices.color(level, 0, table.shape[0], 0, table.shape[1])
        assert (read == table).all()

    def found(row, col):
        level = min(int(diamonds.octave(row, col)), t.levels - 1)
        return float(tables[level][row >> level, col >> level])

    bare = own_errors(method, painted.lab)
    assert len(bare) > 20
    for (row, col), own in bare.items():
        below = [found(*child) for child in children(t, row, col, method.legs)]
        assert found(row, col) == pytest.approx(max([own, *below]), abs=1e-3), (row, col)


def children(t, row, col, legs):
    """The diamonds right below one in the DAG that may have TINs."""
    s = int(diamonds.spacing(row, col))
    if int(diamonds.kind(row, col)) == diamonds.SQUARE:
        around = [(row - s, col), (row + s, col), (row, col - s), (row, col + s)]
    else:
        h = s // 2
        around = [(row + a, col + b) for a in (-h, h) for b in (-h, h)] if s > legs else []
    last = (1 << t.n), (1 << t.n)
    shapes = [t.diamond_shape(level) for level in range(t.levels)]
    for r, c in around:
        level = min(int(diamonds.octave(r, c)), t.levels - 1)
        if 0 <= r <= last[0] and 0 <= c <= last[1] and r >> level < shapes[level][0] and c >> level < shapes[level][1]:
            yield r, c


def test_colors_split_patches_that_are_large_enough_to_be_seen():
    t = plain.terrain(plain.rough(np.random.default_rng(42), (65, 65)))
    painted, view = Painted((65, 65)), whole(t, (1600, 1200))
    camera, counts = Camera.over(t.grid, view), []
    for gamma in (60.0, 25.0, 10.0):
        found = made(t, gamma, painted, legs=4).select(camera, Goal(500.0))
        counts.append(len(found.batches))
        for batch in found.batches[::3]:
            assert off_of((batch.vertices, batch.triangles), painted.lab) <= gamma + 1e-3
        assert verify.judge_mesh(found.tessellation(), t, view).defects == {}
    assert counts[0] < counts[1] < counts[2]
    with pytest.raises(UsageError, match="needs colours"):
        chosen("bdam,color-tolerance=2").make(t)
