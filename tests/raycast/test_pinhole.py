"""Pinhole cameras: beams and marching blocks against brute force on small fields, against Embree on a larger one."""

from __future__ import annotations

import brute
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.raycast.caster import Caster
from orograph.raycast.stack import HeightWindow

Array = np.ndarray


def basis(
    eye: Array, target: Array, size: tuple[int, int], fov: float, roll: float = 0.0
) -> tuple[Array, Array, Array]:
    """d0, du, dv in sample coordinates (rows run down, as north-up rasters have it)."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0])
    right = np.cross(up, forward)
    right = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    up = np.cross(forward, right)
    a = np.radians(roll)
    right, up = np.cos(a) * right + np.sin(a) * up, np.cos(a) * up - np.sin(a) * right
    s = 2 * np.tan(np.radians(fov) / 2) / size[0]
    return forward + right * s * (0.5 - size[1] / 2) - up * s * (0.5 - size[0] / 2), right * s, -up * s


def pixels(d0: Array, du: Array, dv: Array, size: tuple[int, int]) -> Array:
    py, px = np.mgrid[0 : size[0], 0 : size[1]]
    return (d0 + px[..., None] * du + py[..., None] * dv).reshape(-1, 3)


def compare(
    h: Array, eye: Array, target: Array, fov: float, roll: float, near: float = 0.0, far: float = np.inf
) -> int:
    size = (21, 37)
    d0, du, dv = basis(eye, target, size, fov, roll)
    t, _ = Caster.of(h, 1).cast_pinhole(eye, d0, du, dv, size, near, far)
    d = pixels(d0, du, dv, size)
    brute.check(h, np.broadcast_to(eye, d.shape), d, t.ravel(), near, far)
    return int(np.isfinite(t).sum())


CAMERAS = {
    "oblique": ((-8, 30, 30), (12, 8, 0), 40, 0),
    "rolled": ((-8, 30, 30), (12, 8, 0), 40, 35),
    "on its side": ((-8, 30, 20), (12, 8, 0), 40, 90),
    "upside down": ((-8, 30, 20), (12, 8, 0), 40, 180),
    "straight down": ((11, 9, 60), (11, 9, 0), 30, 0),
    "straight down, turned": ((11.3, 9.1, 60), (11.3, 9.1, 0), 30, 20),
    "grazing": ((-3, 9, 4.0), (24, 10, 3.0), 40, 0),
    "over the middle": ((11.2, 8.7, 9), (20, 12, 0), 70, 0),
    "over the middle, looking down": ((11.2, 8.7, 9), (11.6, 8.9, 0), 120, 10),
    "wide": ((2.2, 2.7, 6.0), (20, 16, 5), 140, 5),
    "along an edge": ((-5, 8, 5.0), (20, 8, 0), 30, 0),
    "from a corner, along a diagonal": ((-4, -4, 6.0), (10, 10, 0), 30, 0),
    "lower than the ground, from outside": ((-10, 9, -1.0), (12, 9, 1.0), 50, 0),
    "from below, looking up": ((11, 9, -30), (12, 9.5, 0), 60, 15),
    "from below, outside, looking up": ((-14, 9, -14), (12, 9.5, 0), 70, 0),
    "away from the field": ((-10, 9, 9), (-20, 9, 0), 40, 0),
    "up at the sky": ((11, 9, 9), (12, 9, 30), 40, 0),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("ground", ["rough", "holes", "integer"])
def test_first_hits(name: str, ground: str) -> None:
    rng = np.random.default_rng(4)
    h = rng.normal(0, 1.2, (18, 23)).astype(np.float32)
    if ground == "holes":
        h[rng.random(h.shape) < 0.1] = np.nan
    elif ground == "integer":
        h = np.round(h)
    eye, target, fov, roll = CAMERAS[name]
    hits = compare(h, np.array(eye, float), np.array(target, float), fov, roll)
    assert (hits == 0) == (name in ("away from the field", "up at the sky"))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(2, 18),
    cols=st.integers(2, 24),
    ground=st.sampled_from(["rough", "holes", "steps"]),
    where=st.sampled_from(["over", "inside", "outside", "beneath"]),
    roll=st.sampled_from([0.0, 0.0, 17.0, 90.0, 181.0]),
    limited=st.booleans(),
)
def test_any_camera(seed: int, rows: int, cols: int, ground: str, where: str, roll: float, limited: bool) -> None:
    rng = np.random.default_rng(seed)
    h = rng.normal(0, 2, (rows, cols)).astype(np.float32)
    if ground == "holes":
        h[rng.random(h.shape) < 0.2] = np.nan
    elif ground == "steps":
        h = np.where(h > 0, np.float32(6), np.float32(0))
    span = np.array([cols - 1, rows - 1, 4.0])
    eye = rng.random(3) * span
    if where == "over":
        eye[2] += 6 + 10 * rng.random()
    elif where == "outside":
        eye[:2] += rng.choice([-1, 1], 2) * (span[:2] + 3)
    elif where == "beneath":
        eye[2] -= 8
    target = rng.random(3) * span - [0, 0, 2]
    near, far = (rng.random() * 4, 4 + rng.random() * 20) if limited else (0.0, np.inf)
    compare(h, eye, target, 20 + 80 * rng.random(), roll, near, far)


def test_a_camera_under_the_ground_sees_its_underside() -> None:
    h = np.random.default_rng(8).normal(0, 1, (18, 23)).astype(np.float32)
    eye, target = np.array([11.0, 9.0, -6.0]), np.array([12.0, 9.0, 0.0])
    assert compare(h, eye, target, 60, 0) == 21 * 37


def test_an_eye_over_a_hole_below_its_rim() -> None:
    h = np.full((18, 23), 5, np.float32)
    h[7:12, 9:14] = np.nan
    h[0] = 9
    assert compare(h, np.array([11.0, 9.0, 3.0]), np.array([11.0, 0.0, 6.0]), 90, 0) > 100


@pytest.fixture(scope="module")
def hills() -> Array:
    """Fractal ground, 257 × 301 samples."""
    rng = np.random.default_rng(6)
    spectrum = np.fft.rfft2(rng.normal(size=(257, 301)))
    k = np.hypot(np.fft.fftfreq(257)[:, None], np.fft.rfftfreq(301)[None])
    k[0, 0] = 1
    z = np.fft.irfft2(spectrum / k**1.9, s=(257, 301))
    return ((z - z.min()) / np.ptp(z) * 60).astype(np.float32)


def embree(h: Array) -> tuple[object, object]:
    """A scene of Embree's, and its mesh, which must live as long."""
    mesh_construction = pytest.importorskip("embreex.mesh_construction")
    from embreex import rtcore_scene

    scene = rtcore_scene.EmbreeScene()
    return scene, mesh_construction.TriangleMesh(scene, triangles(h).astype(np.float32))


def triangles(h: Array) -> Array:
    rows, cols = h.shape
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    p = np.stack([x, y, h], -1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    even = ((y + x)[:-1, :-1, None, None] % 2) == 0
    first = np.where(even, np.stack([a, b, d], 2), np.stack([a, b, c], 2))
    second = np.where(even, np.stack([a, d, c], 2), np.stack([b, d, c], 2))
    tri = np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)])
    return tri[np.isfinite(tri).all((1, 2))]


@pytest.mark.parametrize("roll", [0, 3, 60])
@pytest.mark.parametrize("holes", [False, True])
def test_agrees_with_embree(hills: Array, roll: float, holes: bool) -> None:
    h = hills.copy()
    if holes:
        h[np.random.default_rng(1).random(h.shape) < 0.01] = np.nan
    scene, _mesh = embree(h)
    size = (120, 200)
    views = {
        "oblique": ((-80, 400, 170), (150, 128, 20)),
        "low": ((40, 40, h[np.isfinite(h)].max() * 0.8), (300, 256, 30)),
        "horizon": ((10, 240, 62), (300, 10, 55)),
        "down": ((150, 128, 300), (150.1, 128, 0)),
        "beside": ((-60, 120, 20), (150, 128, 25)),
    }
    for name, (eye, target) in views.items():
        eye, target = np.array(eye, float), np.array(target, float)
        d0, du, dv = basis(eye, target, size, 45, roll)
        t, _ = Caster.of(h, 2).cast_pinhole(eye, d0, du, dv, size)
        d = pixels(d0, du, dv, size).astype(np.float32)
        theirs = scene.run(np.broadcast_to(eye, d.shape).astype(np.float32).copy(), d, query="DISTANCE")  # type: ignore[attr-defined]
        hit, ours = theirs < 1e30, np.isfinite(t.ravel())
        assert (hit == ours).mean() >= 0.9995, (name, (hit != ours).sum())
        both = hit & ours
        assert both.sum() > 3000, name
        off = np.abs(theirs[both] - t.ravel()[both]) > 1e-4 * t.ravel()[both]
        assert off.mean() <= 0.0005, (name, off.sum())


def test_the_pinhole_and_the_rays_agree(hills: Array) -> None:
    """The same rays through both faces of the caster: same hits, to rounding."""
    size = (90, 160)
    for eye, target in (((20.0, 20.0, 50.0), (250.0, 200.0, 40.0)), ((150.0, 400.0, 150.0), (150.0, 100.0, 0.0))):
        e = np.array(eye)
        d0, du, dv = basis(e, np.array(target), size, 50)
        caster = Caster.of(hills, 1)
        t, _ = caster.cast_pinhole(e, d0, du, dv, size)
        d = pixels(d0, du, dv, size)
        u, _ = caster.cast(np.broadcast_to(e, d.shape).copy(), d)
        np.testing.assert_allclose(t.ravel(), u, rtol=1e-9)


def test_threads_do_not_change_a_bit(hills: Array) -> None:
    size = (100, 170)
    e = np.array([20.0, 20.0, 50.0])
    d0, du, dv = basis(e, np.array([250.0, 200.0, 40.0]), size, 50)
    results = [Caster.of(hills, jobs).cast_pinhole(e, d0, du, dv, size) for jobs in (1, 2)]
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


# ---- nested windows --------------------------------------------------------------------------------------------------


def nested(h: Array, level: int) -> Array:
    """Level's samples as a terrain reads them: the last repeated where the level reaches beyond the raster."""
    rows, cols = h.shape
    step = 2**level
    r = np.minimum(np.arange(-(-(rows - 1) // step) + 1) * step, rows - 1)
    c = np.minimum(np.arange(-(-(cols - 1) // step) + 1) * step, cols - 1)
    return np.ascontiguousarray(h[np.ix_(r, c)])


def windows(h: Array, *wanted: tuple[int, int, int, int, int]) -> list[HeightWindow]:
    """(level, row0, row1, col0, col1) → windows."""
    return [HeightWindow(k, c0, r0, np.ascontiguousarray(nested(h, k)[r0:r1, c0:c1])) for k, r0, r1, c0, c1 in wanted]


THREE = ((3, 0, 999, 0, 999), (1, 16, 90, 24, 110), (0, 60, 131, 80, 181))
VIEWS = (
    ((20.0, 20.0, 50.0), (250.0, 200.0, 40.0), 0.0),
    ((120.0, 90.0, 80.0), (130.0, 100.0, 0.0), 0.0),
    ((110.0, 90.0, 60.0), (200.0, 300.0, 20.0), 20.0),
    ((150.0, 400.0, 150.0), (150.0, 100.0, 0.0), 0.0),
    ((-70.0, 100.0, -60.0), (150.0, 100.0, 20.0), 0.0),
    ((130.0, 100.0, -80.0), (130.0, 110.0, 0.0), 0.0),
)


@pytest.mark.parametrize("eye, target, roll", VIEWS)
def test_windows_of_a_plane_are_the_plane(eye: tuple, target: tuple, roll: float) -> None:
    """Where all levels are the same surface, a stack of them is the single window."""
    y, x = np.mgrid[0:257, 0:297].astype(float)
    h = (0.1 * x - 0.05 * y + 20).astype(np.float32)
    size = (60, 90)
    e = np.array(eye)
    d0, du, dv = basis(e, np.array(target), size, 60, roll)
    t, _ = Caster.of(h, 1).cast_pinhole(e, d0, du, dv, size)
    stack = Caster(windows(h, *THREE), h.shape, 1)
    u, which = stack.cast_pinhole(e, d0, du, dv, size)
    assert np.isfinite(t).sum() > 500
    np.testing.assert_array_equal(np.isfinite(t), np.isfinite(u))
    np.testing.assert_allclose(u, t, rtol=1e-6)
    d = pixels(d0, du, dv, size)
    v, _ = stack.cast(np.broadcast_to(e, d.shape).copy(), d)
    np.testing.assert_allclose(v.reshape(size), t, rtol=1e-6)
    # Each hit is on the finest window that holds its place.
    p = e + t.reshape(-1, 1) * d
    hit = np.isfinite(t.ravel())
    expected = np.zeros(len(p), int)
    f = stack.stack.scene.floats
    for w in (1, 2):
        expected[(p[:, 0] >= f[w, 3]) & (p[:, 0] <= f[w, 5]) & (p[:, 1] >= f[w, 4]) & (p[:, 1] <= f[w, 6])] = w
    clear = np.ones(len(p), bool)
    for w in (1, 2):
        for k, lo, hi in ((0, 3, 5), (1, 4, 6)):
            clear &= (np.abs(p[:, k] - f[w, lo]) > 1e-3) & (np.abs(p[:, k] - f[w, hi]) > 1e-3)
    np.testing.assert_array_equal(which.ravel()[hit & clear], expected[hit & clear])


@pytest.mark.parametrize("levels", [(2, 0), (3, 1, 0), (4, 2)])
def test_no_crack_between_levels(levels: tuple[int, ...]) -> None:
    """On steep random ground neighbouring levels disagree by hundreds of metres; nothing is seen through the step."""
    rng = np.random.default_rng(12)
    h = rng.normal(0, 300, (129, 161)).astype(np.float32)
    wanted = [(levels[0], 0, 999, 0, 999)]
    for i, k in enumerate(levels[1:]):
        inset = 20 * (i + 1)
        a, b, c, d = (int(v) >> k & ~1 for v in (inset, 129 - inset, inset + 8, 161 - inset))
        wanted.append((k, a, b + 1, c, d + 1))
    caster = Caster(windows(h, *wanted), h.shape, 1)
    n = 20000
    o = np.stack([rng.random(n) * 158 + 1, rng.random(n) * 126 + 1, np.full(n, 3000.0)], 1)
    to = np.stack([rng.random(n) * 158 + 1, rng.random(n) * 126 + 1, np.full(n, -3000.0)], 1)
    f = caster.stack.scene.floats
    border = f[rng.integers(1, len(f), n // 2)]
    onto = rng.integers(0, 2, n // 2)
    to[: n // 2, 0] = np.where(onto == 0, border[:, 3], to[: n // 2, 0])  # half aim at borders of windows
    to[: n // 2, 1] = np.where(onto == 1, border[:, 6], to[: n // 2, 1])
    straight = rng.random(n) < 0.3
    o[straight, :2] = to[straight, :2]
    t, _ = caster.cast(o, to - o)
    assert np.isfinite(t).all()
    t, _ = caster.cast(to, o - to)  # and from beneath
    assert np.isfinite(t).all()
    eye = np.array([80.0, 64.0, 2000.0])
    size = (200, 260)
    d0, du, dv = basis(eye, np.array([80.0, 64.0, 0.0]), size, 2.0)
    t, which = caster.cast_pinhole(eye, d0 * [1, 1, 50], du, dv, size)
    assert np.isfinite(t).all()
    assert len(np.unique(which)) >= 1


def test_a_stack_with_holes_is_open_only_where_it_has_holes() -> None:
    h = np.random.default_rng(3).normal(0, 5, (65, 65)).astype(np.float32)
    h[20:30, 20:30] = np.nan
    caster = Caster(windows(h, (2, 0, 999, 0, 999), (0, 12, 41, 12, 41)), h.shape, 1)
    rng = np.random.default_rng(4)
    p = rng.random((4000, 2)) * 64
    o = np.column_stack([p, np.full(4000, 100.0)])
    t, which = caster.cast(o, np.tile([0.0, 0.0, -1.0], (4000, 1)))
    fine = (np.abs(p - 26) < 14).all(1)
    expected = np.isfinite(brute.height(h, p[fine, 0], p[fine, 1]))
    np.testing.assert_array_equal(np.isfinite(t[fine]), expected)
    assert (which[fine][expected] == 1).all()
    assert np.isfinite(t[~fine]).all()


def test_the_smallest_pyramids_tell_the_range_of_heights() -> None:
    from orograph.raycast.mips import build_mips

    for shape in ((2, 2), (2, 9), (3, 4), (9, 9), (10, 2)):
        h = np.random.default_rng(1).normal(size=shape).astype(np.float32)
        assert build_mips(h).height_range == (h.min(), h.max())


@pytest.mark.stress
def test_rays_that_come_in_through_the_side_of_the_terrain() -> None:
    """Above the surface at its side wall, or below it: seen from beside, across a hole in the first row of cells."""
    h = np.random.default_rng(2).normal(0, 1.5, (40, 50)).astype(np.float32)
    h[3:6, :2] = np.nan
    for eye in ((-9.0, 12.0, 0.5), (-3.0, 4.5, 2.5), (20.0, 60.0, 1.0)):
        assert compare(h, np.array(eye), np.array([25.0, 20.0, 0.0]), 60, 0) > 100
