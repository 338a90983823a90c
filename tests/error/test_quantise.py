"""Codes of errors and radii: never less than what they stand for, close to it, in order, and spheres still nested."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import Reference, found, surface

from orograph.error import KINDS
from orograph.error.encode import Encoder
from orograph.error.quantise import EMPTY, ErrorCode, RadiusCode, nominal_radii
from orograph.errors import OrographError

METRIC = np.array([[30.0, 2.0], [-1.0, -25.0]])


def encoder(height_range=800.0, n=9, metric=METRIC):
    errors = {kind: ErrorCode.of(height_range, kind, n) for kind in KINDS}
    return Encoder(errors, RadiusCode.of(height_range, metric, n))


@settings(deadline=None, max_examples=50)
@given(st.floats(1e-3, 9000), st.sampled_from(KINDS), st.integers(1, 17), st.integers(0, 10**6))
def test_errors_are_rounded_up_by_less_than_a_step(height_range, kind, n, seed):
    code = ErrorCode.of(height_range, kind, n)
    rng = np.random.default_rng(seed)
    largest = height_range * (2 * n if kind == "wedgie" else 1)
    errors = (largest * np.exp(-rng.uniform(0, 25, (20, 20)))).astype(np.float32)
    errors[0, :3] = 0, np.inf, largest
    codes = Encoder({kind: code}, RadiusCode.of(1.0, METRIC, 1)).errors(kind, errors)
    decoded = code.decode(codes)
    assert (decoded >= errors).all()
    np.testing.assert_array_equal(codes, np.searchsorted(code.table, errors))
    assert (codes == 0).sum() == (errors == 0).sum() and (codes == 255).sum() == np.isinf(errors).sum()
    known = (errors > 0) & np.isfinite(errors)
    assert (decoded[known] <= np.maximum(errors[known] * code.step, code.lowest) * (1 + 1e-6)).all()
    assert code.step < 1.08
    order = np.argsort(errors, axis=None)
    assert (np.diff(decoded.ravel()[order][: -(~np.isfinite(errors)).sum()]) >= 0).all()


def test_tables_are_in_order_and_are_what_the_metadata_make_of_them():
    code = ErrorCode.of(4000.0, "exact", 12)
    table = ErrorCode(**code.to_json()).table
    assert table.shape == (256,) and (np.diff(table) > 0).all() and table[0] == 0 and np.isinf(table[255])
    np.testing.assert_array_equal(table, code.table)
    assert table[254] >= 4000
    # code 100 by the definition, multiplication after multiplication
    value = code.lowest
    for _ in range(99):
        value *= code.step
    assert value <= table[100] <= value * (1 + 2**-22)
    radius = RadiusCode.of(4000.0, METRIC, 5)
    assert (np.diff(radius.tables, axis=2) > 0).all()


def test_a_flat_terrain_has_only_zeros_and_holes():
    flat = encoder(0.0)
    errors = np.array([[0, np.inf]], np.float32)
    for kind in KINDS:
        np.testing.assert_array_equal(ErrorCode.of(0.0, kind, 9).decode(flat.errors(kind, errors)), errors)
    assert ErrorCode.of(float("nan"), "exact", 0).table[255] == np.inf


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 9), st.integers(0, 9), st.integers(0, 8), st.data())
def test_radii_are_rounded_up_and_empty_ones_stay_empty(rows, cols, row, col, octave, data):
    ours = encoder()
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    edge, square = nominal_radii(METRIC, 9)[octave]
    i, j = np.indices((rows, cols)) + np.array([row, col]).reshape(2, 1, 1)
    nominal = np.where(i & j & 1, square, np.where((i | j) & 1, edge, 0))
    radii = (nominal * (1 + 4 * 800 / 30 / (1 << octave) * np.exp(-rng.uniform(0, 12, (rows, cols))))).astype(
        np.float32
    )
    radii[rng.random(radii.shape) < 0.2] *= -1
    codes = ours.radii(radii, row, col, octave)
    decoded = ours.radius.decode(codes, row, col, octave)
    assert (np.abs(decoded) >= np.abs(radii)).all()
    np.testing.assert_array_equal(np.signbit(decoded) & (decoded != 0), radii < 0)
    np.testing.assert_array_equal((codes & EMPTY) > 0, radii < 0)
    excess, true = np.abs(decoded) - nominal, np.abs(radii) - nominal
    assert (excess <= np.maximum(true * ours.radius.step, nominal * 2.0**-9) * (1 + 1e-5) + nominal * 1e-6).all()
    again = ours.radius.decode(ours.radii(decoded, row, col, octave), row, col, octave)
    np.testing.assert_array_equal(again, decoded)


def test_what_no_code_can_say_is_refused():
    ours = encoder(10.0)
    with pytest.raises(OrographError, match="larger than these heights allow"):
        ours.radii(np.full((2, 2), 1e9, np.float32), 0, 0, 0)


@settings(deadline=None, max_examples=25)
@given(
    st.integers(2, 40), st.integers(2, 40), st.integers(0, 99), st.sampled_from([0, 0.1]), st.sampled_from([0.3, 5, 90])
)
def test_spheres_are_nested_after_rounding(rows, cols, seed, missing, spacing):
    rng = np.random.default_rng(seed)
    z = (rng.random((rows, cols)) * 100).astype(np.float32)
    z[rng.random(z.shape) < missing] = np.nan
    reference = Reference(z, spacing)
    ground = surface(z, spacing)
    height_range = float(np.nanmax(z) - np.nanmin(z)) if not np.isnan(z).all() else float("nan")
    ours = Encoder({}, RadiusCode.of(height_range, ground.metric, ground.n))
    radius, smallest = (found(z, spacing=spacing, rounding=r)["radius"] for r in (ours, None))

    def place(v):
        r, c = reference.squeezed(v)
        h = reference.height(v)
        return np.array([c * spacing, r * spacing, ground.lowest if np.isnan(h) else h])

    for v in reference.diamonds:
        assert (radius[v] < 0) == (smallest[v] < 0)
        if radius[v] < 0:
            continue
        assert radius[v] >= smallest[v]
        k = reference.octave(v)
        table = ours.radius.tables[k, int(reference.is_square(v))]
        assert np.float32(radius[v]) in table
        for u in reference.children(v):
            assert np.linalg.norm(place(u) - place(v)) + abs(radius[u]) <= radius[v] * (1 + 1e-7)
