"""Errors, spheres and holes of diamonds against their definitions, and the same whatever the blocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import Reference, found, nested, surface

from orograph.error import KINDS
from orograph.error.diamonds import diamonds

SHAPES = [(3, 3), (5, 5), (6, 5), (9, 4), (17, 12), (2, 7), (33, 33), (40, 23)]


def heights(shape, seed=0, missing=0.0):
    rng = np.random.default_rng(seed)
    z = (rng.random(shape) * 100).astype(np.float32)
    z[rng.random(shape) < missing] = np.nan
    return z


def close_to(ours, truth):
    """Equal but for the rounding up to float32."""
    return truth * (1 - 1e-12) - 1e-9 <= ours <= truth * (1 + 1e-6) + 1e-4


@pytest.mark.cases(4)
@pytest.mark.parametrize("shape", [*SHAPES[:6], *(pytest.param(one, marks=pytest.mark.stress) for one in SHAPES[6:])])
def test_exact_is_the_largest_deviation_of_any_sample_made_monotonic(shape):
    z = heights(shape)
    reference = Reference(z)
    truth = reference.closed({v: reference.deviation(v) for v in reference.diamonds})
    ours = found(z)["exact"]
    assert set(ours) == set(truth)
    for v, e in truth.items():
        assert close_to(ours[v], e), v


@pytest.mark.parametrize("shape", [(5, 5), (17, 17), (33, 33)])
def test_midpoint_is_the_distance_at_the_vertex_made_monotonic(shape):
    z = heights(shape)
    reference = Reference(z)
    truth = reference.closed({v: reference.local(v) for v in reference.diamonds})
    for v, e in found(z, ("midpoint",))["midpoint"].items():
        assert close_to(e, truth[v]), v


@pytest.mark.parametrize("n", [1, 2, 4, 5])
def test_wedgies_are_the_recursion_of_roam(n):
    """Triangle by triangle: e(T) = max(e(left), e(right)) + |z(middle) − (z(a) + z(b)) / 2|, 0 for a finest T."""
    z = heights((2**n + 1,) * 2)

    def wedgie(apex, a, b):
        middle = (a[0] + b[0]) // 2, (a[1] + b[1]) // 2
        if (a[0] + b[0]) % 2 or (a[1] + b[1]) % 2:
            return 0.0  # half a cell
        local = abs(float(z[middle]) - (float(z[a]) + float(z[b])) / 2)
        e = local + max(wedgie(middle, apex, a), wedgie(middle, b, apex))
        largest[middle] = max(largest.get(middle, 0.0), e)
        return e

    largest = {}
    end = 2**n
    wedgie((0, end), (0, 0), (end, end))
    wedgie((end, 0), (end, end), (0, 0))
    reference = Reference(z)
    truth = reference.closed(largest)
    ours = found(z, ("wedgie",))["wedgie"]
    assert set(ours) == set(truth)
    for v, e in truth.items():
        assert close_to(ours[v], e), v


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 99), st.sampled_from([0.0, 0.02, 0.3]))
def test_bounds_hold_in_every_diamond(rows, cols, seed, missing):
    """Whatever the raster: monotonic, wedgie ≥ exact ≥ midpoint, and nothing of a hole in an error."""
    z = heights((rows, cols), seed, missing)
    reference = Reference(z)
    values = found(z, KINDS)
    for v in reference.diamonds:
        assert values["exact"][v] <= values["wedgie"][v] * (1 + 1e-6)
        for kind in KINDS:
            e = values[kind][v]
            assert not np.isnan(e)
            for u in reference.children(v):
                assert values[kind][u] <= e
            if not np.isinf(e):
                assert e <= (100 if kind != "wedgie" else 200 * max(reference.n, 1)) * (1 + 1e-5)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 34), st.integers(2, 34), st.integers(0, 99), st.sampled_from([0.01, 0.2, 0.7, 1.0]))
def test_mixed_and_empty(rows, cols, seed, missing):
    z = heights((rows, cols), seed, missing)
    reference = Reference(z)
    values = found(z)
    for v in reference.diamonds:
        state = reference.state(v)
        mixed, empty = np.isinf(values["exact"][v]), values["radius"][v] < 0
        children = [u for u in reference.children(v) if np.isinf(values["exact"][u])]
        if not reference.straddles(v):
            assert mixed == (state == "mixed" or bool(children)), (v, state)
            assert empty == (state == "empty"), (v, state)
        else:  # the squeeze may move ground into a diamond that has none of its own
            assert mixed or state != "mixed", v
            assert not empty or state == "empty", v
        assert not empty or values["exact"][v] == 0 or children


def test_missing_samples_do_not_count_and_their_neighbours_do():
    z = np.zeros((33, 33), np.float32)
    z[16, 16] = np.nan
    z[3, 5] = 5
    values = found(z)["exact"]
    assert np.isinf([values[16, 15], values[16, 16], values[8, 8]]).all()  # the last has its corner there
    assert values[3, 5] == pytest.approx(5) and values[4, 4] == pytest.approx(5)
    assert values[3, 7] == 0 and values[28, 4] == 0


def test_the_midpoint_error_is_no_bound():
    """Each split of the diagonal brings 8 m, and the next half 8 m more: midpoints never see that 18 m are missing."""
    z = np.zeros((9, 9), np.float32)
    z[4, 4], z[2, 2], z[3, 3] = 8, 8 / 2 + 8, (8 + 12) / 2 + 8
    values = found(z, ("midpoint", "exact", "wedgie"))
    assert Reference(z).deviation((4, 4)) == 18  # drawn as one flat square
    assert values["midpoint"][4, 4] == pytest.approx(8)
    assert values["exact"][4, 4] == pytest.approx(18)
    assert values["wedgie"][4, 4] >= 8 + 8 + 8


@settings(deadline=None, max_examples=20)
@given(st.integers(2, 36), st.integers(2, 36), st.integers(0, 99), st.sampled_from([0.0, 0.1]), st.floats(0.1, 50))
def test_spheres_hold_their_corners_and_their_childrens_spheres(rows, cols, seed, missing, spacing):
    z = heights((rows, cols), seed, missing)
    reference = Reference(z, spacing)
    lowest = np.nanmin(z) if not np.isnan(z).all() else 0.0
    radius = found(z, spacing=spacing)["radius"]

    def place(v):
        r, c = reference.squeezed(v)
        h = reference.height(v)
        return np.array([c * spacing, r * spacing, lowest if np.isnan(h) else h])

    for v in reference.diamonds:
        if radius[v] < 0:
            continue
        for corner in reference.corners(v):
            if reference.inside(corner):
                assert np.linalg.norm(place(corner) - place(v)) <= radius[v]
        for u in reference.children(v):
            assert np.linalg.norm(place(u) - place(v)) + abs(radius[u]) <= radius[v] * (1 + 1e-7) or radius[u] == -1e-30


def test_a_plain_has_the_nominal_spheres():
    from orograph.error.quantise import nominal_radii

    metric = np.array([[3.0, 1.0], [-1.0, 2.5]])
    z = np.zeros((65, 65), np.float32)
    ground = surface(z)
    nominal = nominal_radii(metric, 6)
    for part in diamonds(lambda a, b, c, d: z[a:b, c:d], nested(z), type(ground)(z.shape, metric, z[:1, :1], 0.0)):
        edge, square = nominal[part.octave]
        assert part.radii[1::2, 1::2] == pytest.approx(square, rel=1e-6)
        interior = part.radii[2:-1:2, 1::2]  # beyond the border corners are missing
        if interior.size:
            assert interior == pytest.approx(edge, rel=1e-6)


def parts_of(z, kinds=KINDS, **options):
    whole = {}
    for part in diamonds(lambda a, b, c, d: z[a:b, c:d], nested(z), surface(z, 7.0), kinds, **options):
        for name, values in (*part.errors.items(), ("radius", part.radii)):
            for i, row in enumerate(values):
                whole.setdefault((part.octave, name, part.i + i), {})[part.j] = row.tobytes()
    return {key: b"".join(rows[j] for j in sorted(rows)) for key, rows in whole.items()}


@pytest.mark.parametrize("missing", [0.0, 0.001])
def test_blocks_of_any_size_in_any_order_by_any_number_of_threads_find_the_same(missing):
    z = heights((300, 213), 5, missing)
    rng = np.random.default_rng(1)
    whole = parts_of(z, block=1024, jobs=1)
    for block, jobs in ((32, 1), (64, 2), (128, 3)):
        order = [(i, j) for i in range(-(-300 // block)) for j in range(-(-213 // block))]
        rng.shuffle(order)
        order = [(int(i), int(j)) for i, j in order]
        assert parts_of(z, block=block, jobs=jobs, order=order) == whole, (block, jobs)


def test_each_kind_alone_is_what_it_is_among_others():
    z = heights((90, 70), 3, 0.01)
    together = parts_of(z)
    for kind in KINDS:
        alone = parts_of(z, (kind,))
        assert all(together[key] == value for key, value in alone.items())
