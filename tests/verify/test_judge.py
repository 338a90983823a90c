"""The referee against brute force (exact fractions, every pair, the view's own projection) on sound and broken meshes,
and against analytic surfaces."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction

import broken_meshes as meshes
import exact_referee as brute
import numpy as np
import pytest
from affine import Affine
from hypothesis import example, given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.tessellation import Tessellation
from orograph.verify import Report, judge_mesh, strips
from orograph.viewpoint import View

SHAPES = [(5, 5), (6, 7), (4, 9), (7, 4), (3, 5), (2, 3), (2, 2)]


def view_of(terrain, rng: np.random.Generator, kind: str) -> View:
    """A camera that sees some of a small terrain: from outside, from within, from below, or straight down."""
    rows, cols = terrain.grid.shape
    x, y = terrain.grid.xy(rng.uniform(0, cols - 1, 2), rng.uniform(0, rows - 1, 2))
    size = max(rows, cols) * max(terrain.grid.spacing)
    target = (float(x[0]), float(y[0]), float(rng.normal(0, 10)))
    fov = float(rng.uniform(10, 110))
    if kind == "inside":  # among the heights, some of which are above the eye and some below
        return View((float(x[1]), float(y[1]), float(rng.normal(0, 10))), target, fov_y=fov, width=400, height=300)
    if kind == "plan":
        eye = (target[0], target[1], target[2] + size)
        return View(eye, target, up=(*rng.normal(0, 1, 2), 0.0), fov_y=fov, width=300, height=200, projection="plan")
    eye = tuple(np.array(target) + rng.normal(0, size, 3))
    near = float(rng.uniform(0, 0.5 * size)) if kind == "slab" else 0.0
    far = near + float(rng.uniform(0.5, 2) * size) if kind == "slab" else math.inf
    return View(eye, target, up=tuple(rng.normal(0, 1, 3)), fov_y=fov, width=300, height=400, near=near, far=far)


def same(report: Report, truth: dict, broken: bool = False) -> None:
    """Compare a report with brute force; overlaps are found for certain, but not each triangle that takes part."""
    values = {name: getattr(report, name) for name in truth if name not in ("overlapping", "rounding")}
    overlapping = truth["overlapping"]
    assert (report.overlaps > 0) == bool(overlapping)
    assert report.overlaps <= len(overlapping)
    for name, value in values.items():
        if name in ("largest", "largest_at_samples", "rms"):
            assert value == pytest.approx(truth[name], rel=1e-6, abs=truth["rounding"]), name
        elif not (overlapping and name in ("holes", "inner", "border", "rim_of_missing", "rim_of_culled")):
            assert value == truth[name], (name, values, truth)
    counted = (name for name in report.defects)
    assert set(report.places) == set(counted)


@pytest.mark.stress
@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from(SHAPES), st.sampled_from(meshes.TRANSFORMS),
    st.sampled_from(["outside", "inside", "plan", "slab"]), st.sampled_from(["right", "full", "delaunay"]),
    st.sampled_from([0.0, 0.1, 0.3]), st.integers(0, 3), st.sampled_from([1.0, 0.5, 3.0]),
)  # fmt: skip
def test_as_brute_force_says(seed, shape, transform, kind, style, missing, breaks, exaggeration):
    """Everything at once: any raster, any camera, holes, conforming meshes broken up to three times."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 10, shape).astype(np.float32)
    if style != "delaunay":
        heights[rng.random(shape) < missing] = np.nan
    terrain = meshes.terrain_of(heights, transform)
    if style == "right":
        made = meshes.right_triangles(heights, rng, rng.uniform(0, 0.3))
    else:
        made = meshes.full(heights) if style == "full" else meshes.delaunay(heights, rng)
    for _ in range(breaks if made else 0):
        made = meshes.BREAKS[int(rng.integers(len(meshes.BREAKS)))](made, rng, (shape[1] - 1, shape[0] - 1)) or made
    made = [t for t in made if all(np.isfinite(heights[r, c]) for c, r in t)]
    mesh = meshes.tessellation(made, terrain)
    view = view_of(terrain, rng, kind)
    truth = brute.judge(mesh, terrain, view, exaggeration)
    report = judge_mesh(mesh, terrain, view, exaggeration=exaggeration, jobs=1)
    same(report, truth)
    if not breaks:
        assert report.defects == {} and report.ok(truth["largest"] * (1 + 1e-6) + truth["rounding"])


@pytest.mark.stress
@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from(SHAPES), st.sampled_from(meshes.TRANSFORMS),
    st.sampled_from(["outside", "inside", "plan", "slab"]), st.sampled_from([1, 3, 10, 24]),
    st.sampled_from([0.0, 0.1, 0.3]), st.integers(0, 3), st.sampled_from([1.0, 0.5, 3.0]),
)  # fmt: skip
@example(130258, (7, 4), meshes.TRANSFORMS[0], "outside", 3, 0.3, 3, 1.0)  # a triangle that only touches the surface
def test_vertices_anywhere_as_brute_force_says(seed, shape, transform, kind, fraction, missing, breaks, exaggeration):
    """Delaunay triangulations of random points at multiples of 2^-fraction of a cell, broken up to three times."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 10, shape).astype(np.float32)
    terrain = meshes.terrain_of(np.where(rng.random(shape) < missing, np.nan, heights), transform)
    made = meshes.delaunay_between(shape, rng, fraction)
    for _ in range(breaks):
        made = meshes.BREAKS[int(rng.integers(len(meshes.BREAKS)))](made, rng, (shape[1] - 1, shape[0] - 1)) or made
    mesh = meshes.tessellation_between(made, meshes.terrain_of(heights, transform), rng)
    view = view_of(terrain, rng, kind)
    truth = brute.judge(mesh, terrain, view, exaggeration)
    same(judge_mesh(mesh, terrain, view, exaggeration=exaggeration, heights="samples", jobs=1), truth)


@pytest.fixture
def whole() -> tuple[meshes.MemoryTerrain, View, list[meshes.Triangle]]:
    """A raster without holes, wholly in view, and a sound mesh of it."""
    rng = np.random.default_rng(5)
    heights = rng.normal(0, 10, (9, 9)).astype(np.float32)
    terrain = meshes.terrain_of(heights)
    view = View((500045, 3999800, 150), (500045, 3999955, 0), fov_y=60)
    return terrain, view, meshes.right_triangles(heights, rng, 0.1)


def test_a_sound_mesh_is_sound(whole):
    terrain, view, made = whole
    report = judge_mesh(meshes.tessellation(made, terrain), terrain, view)
    assert report.ok() and report.defects == {} and report.samples == 81
    assert "no defects" in str(report) and f"{report.largest:.4g} px" in str(report)
    assert not report.ok(report.largest * 0.999) and report.ok(report.largest)
    assert json.loads(json.dumps(report.to_dict()))["worst"] == list(report.worst)


def test_each_kind_of_defect_is_told_by_its_name(whole):
    terrain, view, _ = whole
    made = meshes.full(terrain.heights)
    sound = meshes.tessellation(made, terrain)

    def report(vertices=sound.vertices, triangles=sound.triangles) -> Report:
        return judge_mesh(Tessellation(vertices, np.asarray(triangles, np.int32)), terrain, view)

    flipped = sound.triangles.copy()
    flipped[3] = flipped[3, ::-1]
    assert report(triangles=flipped).defects == {"reversed": 1}
    flat = [*sound.triangles, [0, 0, 1]]
    assert report(triangles=flat).defects.keys() >= {"flat"}
    lifted = sound.vertices.copy()
    lifted[2, 2] = np.nextafter(lifted[2, 2], np.inf)
    assert report(vertices=lifted).defects == {"wrong_heights": 1}
    assert report(vertices=lifted).places["wrong_heights"] == (int(lifted[2, 0]), int(lifted[2, 1]))
    # An inner vertex taken twice: a seam that no eye would see.
    inner = next(i for i, (c, r, _) in enumerate(sound.vertices) if (c, r) == (4, 4))
    around = np.flatnonzero((sound.triangles == inner).any(-1))
    seam = sound.triangles.copy()
    seam[around[0]][seam[around[0]] == inner] = len(sound.vertices)
    doubled = report(np.vstack([sound.vertices, sound.vertices[inner]]), seam)
    assert doubled.defects == {"duplicates": 1, "inner": 4} and doubled.places["duplicates"] == tuple(
        sound.vertices[inner, :2].astype(int)
    )
    fewer = report(triangles=np.delete(sound.triangles, around, 0))
    assert fewer.defects == {"uncovered": 1, "holes": 8, "inner": 8}
    twice = report(triangles=[*sound.triangles, sound.triangles[around[0]]])
    assert twice.defects.keys() == {"overlaps", "crowded"}
    assert twice.overlaps == 2 and twice.crowded == 3
    coarse = [t for t in made if max(p[0] for p in t) <= 4] + [((4, 0), (8, 0), (4, 8)), ((8, 0), (8, 8), (4, 8))]
    cracked = judge_mesh(meshes.tessellation(coarse, terrain), terrain, view)
    assert cracked.defects == {"t_junctions": 7, "inner": 9} and cracked.places["t_junctions"] == (4, 1)
    text = str(twice)
    assert "DEFECT: 2 overlapping triangles" in text and not twice.ok()


def test_a_hole_between_samples_is_seen(whole):
    """A unit triangle left out covers no sample that its neighbours do not: only the ground tells."""
    terrain, view, _ = whole
    made = meshes.full(terrain.heights)
    report = judge_mesh(meshes.tessellation(made[:40] + made[41:], terrain), terrain, view)
    assert report.defects == {"holes": 1, "inner": 3}


def test_missing_ground_must_not_be_covered(whole):
    terrain, view, _ = whole
    heights = terrain.heights.copy()
    heights[4, 4] = np.nan
    holed = meshes.terrain_of(heights)
    exact = judge_mesh(meshes.tessellation(meshes.full(heights), holed), holed, view)
    assert exact.ok() and exact.rim_of_missing == 8 and exact.border == 32
    coarse = meshes.tessellation([((0, 0), (8, 0), (8, 8)), ((0, 0), (0, 8), (8, 8))], holed)
    assert judge_mesh(coarse, holed, view).bridged == 8


def test_ground_out_of_view_may_be_left_out(whole):
    """What lies wholly outside the frustum is left out: a rim, no defect. One triangle more, and it is one."""
    terrain, _, _ = whole
    view = View((500045, 3999800, 30), (500060, 3999955, 0), fov_y=12)
    made = meshes.full(terrain.heights)
    seen = [t for t in made if brute.in_view(terrain, t, view, 1.0)]
    assert 0 < len(seen) < len(made)
    report = judge_mesh(meshes.tessellation(seen, terrain), terrain, view)
    assert report.ok() and report.rim_of_culled > 0
    for k in range(0, len(seen), 5):
        defects = judge_mesh(meshes.tessellation(seen[:k] + seen[k + 1 :], terrain), terrain, view).defects
        assert defects["holes"] == 1
    nothing = judge_mesh(meshes.tessellation([], terrain), terrain, view)
    assert nothing.uncovered == nothing.samples > 0 and nothing.holes == len(seen)
    assert nothing.worst is None and nothing.largest == 0 and not nothing.ok()


def test_error_of_an_analytic_surface():
    """A paraboloid h = k·(c² + r²) seen from the side: what a coarse mesh misses has a closed form."""
    n, k, eye = 256, 2.0**-10, 5e4
    c, r = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    terrain = meshes.terrain_of(k * (c * c + r * r), Affine(1, 0, 0, 0, -1, 0))
    rows = np.arange(0, n, 16)
    made = [t for a in rows for b in rows for x, y in [(int(b), int(a))]
            for t in (((x, y), (x + 16, y), (x + 16, y + 16)), ((x, y), (x, y + 16), (x + 16, y + 16)))]  # fmt: skip
    mesh = meshes.tessellation(made, terrain)
    # From far to the east the screen shows heights at f / distance pixels a metre.
    view = View((eye, -n / 2, 0.0), (0.0, -n / 2, 0.0), fov_y=2.0, width=2000, height=1000)
    report = judge_mesh(mesh, terrain, view, exaggeration=4.0)
    drop = k * 8 * 8 * 2  # in the middle of a diagonal 16·√2 long
    expected = drop * 4.0 / view.pixel_slope / (eye - n + 8)  # worst in the easternmost cells
    assert report.largest == pytest.approx(expected, rel=1e-4)
    assert report.worst is not None and report.worst[0] == n - 8
    # h is convex with independent second differences: errors in a right triangle of legs s are k·(u(s−u) + …) in closed
    # form, with u and v the distances along the legs from a corner on the diagonal.
    u, v = np.meshgrid(np.arange(n + 1) % 16, np.arange(n + 1) % 16)
    low, high = np.minimum(u, v), np.maximum(u, v)
    missed = k * (16 * high - high**2 + 16 * low - low**2)  # plane through (0,0), (s,0), (s,s): s·u·k + s·v·k
    pixels = missed * 4.0 / view.pixel_slope / (eye - c)
    assert report.rms == pytest.approx(float(np.sqrt((pixels**2).mean())), rel=1e-3)
    assert judge_mesh(mesh, terrain, view, exaggeration=8.0).largest == pytest.approx(2 * expected, rel=1e-3)


def test_the_largest_error_may_lie_between_samples():
    """Where a mesh's edge crosses a cell, a vertex within one, and inside a side of a piece seen from above."""
    terrain = meshes.terrain_of(np.zeros((9, 9)), Affine(10, 0, -45, 0, -10, 45))
    side = View((0, -2000, 0), (0, 0, 0), fov_y=4)
    corners = [(0, 0), (8, 0), (8, 8), (0, 8)]
    tent = meshes.tessellation_between(
        [(corners[i], corners[(i + 1) % 4], (4.25, 4.5)) for i in range(4)], terrain, np.random.default_rng(0)
    )
    tent.vertices[:, 2] = np.where(tent.vertices[:, 0] == 4.25, 3.0, 0.0)
    report = judge_mesh(tent, terrain, side)
    assert report.defects == {} and report.worst == (4.25, 4.5)
    assert report.largest == pytest.approx(3.0 / (2000 - 5) / side.pixel_slope, rel=1e-9)
    assert report.largest_at_samples < 0.95 * report.largest
    # A ridge of one sample, cut by a mesh of two triangles along the other diagonal.
    heights = np.zeros((2, 2))
    heights[0, 0] = heights[1, 1] = 6.0
    saddle = meshes.terrain_of(heights, Affine(10, 0, -10, 0, -10, 10))
    across = meshes.tessellation([((0, 0), (1, 0), (0, 1)), ((1, 1), (1, 0), (0, 1))], saddle)
    report = judge_mesh(across, saddle, side)
    assert report.largest_at_samples == 0 and report.worst == (0.5, 0.5)
    assert report.largest == pytest.approx(6.0 / 2000 / side.pixel_slope, rel=1e-9)
    # From above a corner: there the vertical shows as a point, and where it shows the surfaces meet. In between, with
    # r metres from the corner, z·(1 − r/10)·r is largest at r = 5 (to first order in z over the eye's height).
    flat = meshes.terrain_of(np.zeros((2, 2)), Affine(10, 0, -5, 0, -10, 5))
    lifted = meshes.tessellation([((0, 0), (1, 0), (1, 1)), ((0, 0), (0, 1), (1, 1))], flat)
    lifted.vertices[:, 2] = np.where(lifted.vertices[:, :2].sum(1) == 0, 0.01, 0.0)
    above = View((0, 0, 1000), (0, 0, 0), fov_y=4)
    report = judge_mesh(lifted, flat, above, heights="free")
    assert report.largest_at_samples < 1e-9
    assert report.worst == pytest.approx((0.5, 0.5), abs=1e-3)
    expected = 0.01 * 0.5 * math.sqrt(50) / 1000**2 / above.pixel_slope
    assert report.largest == pytest.approx(expected, rel=1e-4)


def test_heights_on_samples_may_be_free(whole):
    terrain, view, made = whole
    mesh = meshes.tessellation(made, terrain)
    mesh.vertices[0, 2] += 1.0
    assert judge_mesh(mesh, terrain, view).wrong_heights == 1
    assert judge_mesh(mesh, terrain, view, heights="free").defects == {}
    morphing = replace(mesh, stats={"geomorph": True})
    assert judge_mesh(morphing, terrain, view).ok() and judge_mesh(morphing, terrain, view).largest > 0.1
    mesh.vertices[0, 2] = np.inf
    assert judge_mesh(mesh, terrain, view, heights="free").wrong_heights == 1


def test_blocks_and_threads_change_nothing_between_samples(monkeypatch: pytest.MonkeyPatch):
    """A large TIN between samples, broken; narrow blocks and one thread, wide ones and three: the same report."""
    rng = np.random.default_rng(8)
    terrain = meshes.terrain_of(rng.normal(0, 0.1, (300, 290)))
    points = np.vstack(
        [rng.integers(0, 289 * 64 + 1, (800, 2)), 64 * np.array([[0, 0], [289, 0], [0, 299], [289, 299]])]
    )
    points = np.unique(points, axis=0)
    made = meshes.Delaunay(points).simplices
    p = points[made]
    turned = (p[:, 1, 0] - p[:, 0, 0]) * (p[:, 2, 1] - p[:, 0, 1]) - (p[:, 2, 0] - p[:, 0, 0]) * (
        p[:, 1, 1] - p[:, 0, 1]
    )
    made = np.where((turned < 0)[:, None], made, made[:, ::-1])[turned != 0].astype(np.int32)
    mesh = Tessellation(np.column_stack([points / 64, rng.normal(0, 3, len(points))]), made)
    x, y = (float(v) for v in terrain.grid.xy(145, 150))
    view = View((x, y - 3000, 2500), (x, y, 0), fov_y=90)
    sound = judge_mesh(mesh, terrain, view)
    assert (
        set(sound.defects) <= {"wrong_heights"}
        and sound.samples == 300 * 290
        and sound.largest > sound.largest_at_samples
    )
    broken = Tessellation(mesh.vertices, np.delete(np.vstack([made, made[700:701]]), [5, 300], axis=0))
    reports = []
    for width, jobs in ((128, 1), (128, 3), (7, 1), (1000, 1)):
        monkeypatch.setattr("orograph.verify.bands.BLOCK", width)
        reports.append(judge_mesh(broken, terrain, view, jobs=jobs))
    assert reports[0] == reports[1] and {"holes", "inner", "overlaps", "crowded"} <= set(reports[0].defects)
    for other in reports[2:]:
        assert other.rms == pytest.approx(reports[0].rms, rel=1e-12)
        assert other.largest == pytest.approx(reports[0].largest, rel=1e-9)
        assert other.defects == reports[0].defects and other.border == reports[0].border


def test_plans_have_no_error(whole):
    terrain, _, made = whole
    plan = View((500045, 3999955, 500), (500045, 3999955, 0), fov_y=60, projection="plan")
    report = judge_mesh(meshes.tessellation(made, terrain), terrain, plan, exaggeration=7.0)
    assert report.samples == 81 and report.largest == 0.0 and report.ok(0.0)


def test_a_mesh_behind_the_eye_is_infinitely_far():
    """The sample is in view, but the mesh at its vertical is lifted past the eye, where nothing can be drawn."""
    heights = np.zeros((3, 3))
    heights[1, 1] = -50.0
    terrain = meshes.terrain_of(heights, Affine(10, 0, 0, 0, -10, 0))
    view = View((15.0, -15.0, -10.0), (15.0, -15.0, -50.0), fov_y=10)
    flat = meshes.tessellation([((0, 0), (2, 0), (2, 2)), ((0, 0), (0, 2), (2, 2))], terrain)
    report = judge_mesh(flat, terrain, view)
    assert report.samples == 1 and report.largest == math.inf and report.worst == (1, 1) and not report.ok(1e9)
    assert report.to_dict()["largest"] is None


@pytest.mark.parametrize("shape", [(600, 530), (257, 1100)])
def test_bands_and_threads_change_nothing(shape):
    """Several bands, several threads: the same report as in one band, defects on the seams included."""
    rng = np.random.default_rng(2)
    terrain = meshes.terrain_of(rng.normal(0, 3, shape))
    rows, cols = shape
    r, c = np.mgrid[0 : rows - 1, 0 : cols - 1]
    even = ((r + c) % 2 == 0)[..., None]
    a, b, d, e = (np.stack([c + i, r + j], -1) for j in (0, 1) for i in (0, 1))
    corners = np.stack([np.where(even, a, a), np.where(even, b, d), np.where(even, e, b)], -2).reshape(-1, 3, 2)
    lower = np.stack([np.where(even, a, b), np.where(even, d, d), np.where(even, e, e)], -2).reshape(-1, 3, 2)
    keys = np.concatenate([corners, lower])
    keys = keys[..., 1] << 32 | keys[..., 0]
    area_sign = -1
    grid = terrain.grid
    z = terrain.heights[keys >> 32, keys & 0xFFFFFFFF]
    p, q = keys & 0xFFFFFFFF, keys >> 32
    turn = (p[:, 1] - p[:, 0]) * (q[:, 2] - q[:, 0]) - (p[:, 2] - p[:, 0]) * (q[:, 1] - q[:, 0])
    keys = np.where((turn * area_sign > 0)[:, None], keys, keys[:, ::-1])
    z = terrain.heights[keys >> 32, keys & 0xFFFFFFFF]
    mesh = Tessellation.from_triangles(grid, keys, z, clockwise=False)
    x, y = grid.xy(cols / 2, rows / 2)
    view = View((float(x), float(y) - 4000, 2500), (float(x), float(y), 0), fov_y=90)
    sound = judge_mesh(mesh, terrain, view, jobs=1)
    assert sound.ok() and sound.samples == rows * cols and sound.largest < 1e-8
    assert sound.border == 2 * (rows + cols - 2)
    # A coarse triangle instead of the fine ones, across the seam of two bands: leave out what it covers.
    place = mesh.vertices[mesh.triangles][..., :2].mean(1)
    inside = (place[:, 0] > 200) & (place[:, 0] < 232) & (place[:, 1] > 240) & (place[:, 1] < min(272, rows - 1))
    holed = Tessellation(mesh.vertices, mesh.triangles[~inside])
    reports = [judge_mesh(holed, terrain, view, jobs=jobs) for jobs in (1, 3)]
    assert reports[0] == reports[1]
    height = min(272, rows - 1) - 240
    assert reports[0].holes == 2 * 32 * height
    sides = 2 * 32 + 2 * height if height == 32 else 32 + 2 * height
    assert reports[0].inner == sides and reports[0].uncovered == 31 * (31 if height == 32 else height)


def test_only_what_is_in_view_is_read_and_all_of_it():
    """A narrow view of a large terrain: as many samples as its planes say, and few others read."""
    rng = np.random.default_rng(4)
    heights = rng.normal(0, 30, (1500, 1300)).astype(np.float32)

    class Counting(meshes.MemoryTerrain):
        read_samples = 0

        def read(self, level, row0, row1, col0, col1):
            self.read_samples += (row1 - row0) * (col1 - col0)
            return super().read(level, row0, row1, col0, col1)

    terrain = Counting(heights, meshes.terrain_of(heights).grid, "large")
    rows, cols = np.mgrid[0:1500, 0:1300]
    x, y = terrain.grid.xy(cols, rows)
    for at, fov in (((1200, 1400), 3.0), ((700, 300), 8.0), ((650, 750), 1.0)):
        east, north = (float(v) for v in terrain.grid.xy(*at))
        view = View((east - 4000, north - 1000, 900), (east, north, 0), fov_y=fov, width=300, height=300)
        inside = (np.stack([x, y, 2.0 * heights, np.ones(x.shape)], -1) @ view.frustum(2.0).T >= 0).all(-1)
        terrain.read_samples = 0
        report = judge_mesh(meshes.tessellation([], terrain), terrain, view, exaggeration=2.0)
        assert report.uncovered == report.samples == inside.sum() > 100
        assert terrain.read_samples < heights.size / 2


def test_rims_on_the_seam_of_two_bands():
    """A block of mesh that begins on a band's first row and ends on another's, in few columns."""
    terrain = meshes.terrain_of(np.random.default_rng(3).normal(0, 3, (700, 600)))
    block = terrain.heights.copy()
    block[:, :100], block[:, 131:], block[:256], block[513:] = np.nan, np.nan, np.nan, np.nan
    made = meshes.full(block[256:513, 100:131])
    mesh = meshes.tessellation([tuple((c + 100, r + 256) for c, r in t) for t in made], terrain)
    around = 2 * (30 + 256)
    for at, name in (((500, 50), "rim_of_culled"), ((115, 384), "inner")):
        x, y = (float(v) for v in terrain.grid.xy(*at))
        view = View((x, y, 1000), (x, y, 0), fov_y=170 if name == "inner" else 20, width=500, height=500)
        report = judge_mesh(mesh, terrain, view)
        assert getattr(report, name) == around and report.border + report.rim_of_missing == 0
        assert report.ok() == (name == "rim_of_culled" and report.samples == 0) and report.uncovered + around > around
    holed = meshes.MemoryTerrain(block, terrain.grid, "block")
    report = judge_mesh(mesh, holed, view)
    assert report.rim_of_missing == around and report.ok()


def test_thin_bands_and_wide_rasters(monkeypatch: pytest.MonkeyPatch):
    """The fewest rows at once: the same report."""
    rng = np.random.default_rng(6)
    heights = rng.normal(0, 10, (40, 33)).astype(np.float32)
    heights[rng.random(heights.shape) < 0.02] = np.nan
    terrain = meshes.terrain_of(heights)
    made = meshes.full(heights)
    mesh = meshes.tessellation(made[:50] + made[51:], terrain)
    view = view_of(terrain, rng, "outside")
    whole = judge_mesh(mesh, terrain, view)
    monkeypatch.setattr("orograph.verify.bands.BAND_BYTES", 1)
    one, many = judge_mesh(mesh, terrain, view, jobs=1), judge_mesh(mesh, terrain, view, jobs=3)
    assert one == many and one.rms == pytest.approx(whole.rms, rel=1e-12) and not whole.ok()
    assert replace(one, rms=whole.rms) == whole


def test_rasters_without_ground():
    """A single row, a single sample, nothing but missing samples: no triangle, no sample of a surface, no defect."""
    view = View((500100, 3999900, 100), (500000, 4000000, 0))
    for heights in (np.zeros((1, 9)), np.zeros((9, 1)), np.zeros((1, 1)), np.full((9, 9), np.nan)):
        terrain = meshes.terrain_of(heights)
        report = judge_mesh(meshes.tessellation([], terrain), terrain, view)
        assert report.ok(0.0) and report.samples == 0 and report.worst is None


def test_vertices_at_missing_samples_are_wrong(whole):
    terrain, view, made = whole
    heights = terrain.heights.copy()
    heights[0, 0] = np.nan
    for value in (0.0, np.nan):
        mesh = meshes.tessellation(made, terrain)
        at = np.flatnonzero((mesh.vertices[:, :2] == 0).all(-1))
        mesh.vertices[at, 2] = value
        report = judge_mesh(mesh, meshes.terrain_of(heights), view)
        assert report.wrong_heights == 1 and report.places["wrong_heights"] == (0, 0) and report.bridged > 0


side = st.integers(1, 1 << 30)
column = st.integers(0, (1 << 30) - 1)


@pytest.mark.stress
@settings(max_examples=300, deadline=None)
@given(column, column, side, column, column, side, st.integers(0, 1), st.data())
def test_fractions_are_exact_at_the_largest_rasters(a, b, d, e, f, g, half, data):
    """Trapezoids between two edges of up to 2^30 rows, in one of their strips, against units near them."""
    k, row = data.draw(st.integers(0, d - 1)), data.draw(st.integers(0, 1 << 30))
    j = data.draw(st.integers(0, g - 1))
    wn, wdx, wd = a * d + (b - a) * k, b - a, d
    en, edx, ed = e * g + (f - e) * j, f - e, g
    west = [Fraction(wn, wd), Fraction(wn + wdx, wd)]
    east = [Fraction(en, ed), Fraction(en + edx, ed)]
    if west[0] > east[0] or west[1] > east[1] or west == east:
        west, east = east, west
        wn, wdx, wd, en, edx, ed = en, edx, ed, wn, wdx, wd
    if west[0] > east[0] or west[1] > east[1] or west == east:
        return  # they cross: no trapezoid
    near = [int(v) + o for v in (*west, *east) for o in (-1, 0, 1)]
    for c in near:
        (corners, _) = meshes.units(np.zeros((2, 3)))[(c + row) % 2, 0, half]
        unit = [(x - (c + row) % 2 + c, y) for x, y in corners]
        polygon = brute.clip([(west[0], 0), (east[0], 0), (east[1], 1), (west[1], 1)], tuple(unit))
        twice = sum(p[0] * q[1] - q[0] * p[1] for p, q in zip(polygon, polygon[1:] + polygon[:1]))
        assert strips.meets_unit(wn, wdx, wd, en, edx, ed, c, half, strips.Strip(row, row, row + 1, 0)) == (twice != 0)


def test_what_cannot_be_judged_is_refused(whole):
    terrain, view, made = whole
    mesh = meshes.tessellation(made, terrain)
    for bad, why in (((1 / 3, 1), "finer"), ((9, 0), "beyond"), ((-1, 0), "beyond"), ((np.nan, 0), "beyond")):
        vertices = mesh.vertices.copy()
        vertices[0, :2] = bad
        with pytest.raises(UsageError, match=f"Vertex 0.*{why}"):
            judge_mesh(Tessellation(vertices, mesh.triangles), terrain, view)
    with pytest.raises(UsageError, match="exaggeration"):
        judge_mesh(mesh, terrain, view, exaggeration=0)


@pytest.mark.parametrize("count", [0, 1, 2, 25, 1000])
def test_the_referee_sorts_as_numpy_does(count):
    from orograph.verify.edges import sort
    from orograph.verify.spans import sort_by

    rng = np.random.default_rng(count)
    keys, items = rng.integers(-9, 9, count), np.arange(count)
    apart = np.concatenate([[7, -7], keys, [-8, 8]])
    sort(apart, 2, 2 + count)
    assert apart.tolist() == [7, -7, *np.sort(keys), -8, 8]
    ordered = keys.astype(float)
    sort_by(ordered, items, len(items))
    assert (ordered == np.sort(keys)).all() and (keys[items] == ordered).all() and set(items) == set(range(count))
