"""Many rays against a stack of nested windows: the loops that the caster's threads run.

A *window* is a rectangle of samples of one level of the terrain; windows are nested, the outermost and coarsest first.
A ray is cut by their borders into at most 2·W − 1 stretches, each on the finest window that contains it, and runs
through them in order. Where two levels disagree at a border, the change of side is a hit on the border: no crack can be
seen through.

Pixels of a pinhole camera are taken in blocks. Eight columns of eight pixels of a block have a *front* each, pushed
outward side by side (see ``fronts``); eight rays begin where a front stops, and walk side by side (see ``packets``).
Those that fly far from there, over a ridge into the next valley, are collected and pushed on in eights. What is left
(rays below the ground, the eye in it) is cast one by one.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES, counted, least, load, most, size, some, spread, store, where
from orograph._numba import inlined, kernel, leaf
from orograph.raycast.fronts import Beams, advance, cones, grazes, row_slope, row_slopes, turns, wedges
from orograph.raycast.packets import ABOVE, BESIDE, TIRED, UNKNOWN, walk_packet, within
from orograph.raycast.tables import EAST, NORTH, SCALE, SOUTH, WEST
from orograph.raycast.traverse import cast, clip

INF = np.inf

BLOCK_X, BLOCK_Y, LOW = 64, 16, 4
"""Pixels: a block, of a row of LANES beams of LANES columns; and how many rows share a beam where there is no wedge."""

CELLS, STEPS = 0.5, 32
"""The shortest stretch that fronts try, in cells; and how many steps from cell to cell a packet takes."""

FURTHER, ROUNDS = 4.0, 16
"""Of rays that have taken their steps: the shortest stretch that is tried for them, in cells, and how many times."""

FRONT, START, X, Y, T = (LANES * k for k in range(5))
"""Where eight numbers each are laid down, to be taken one by one."""


@leaf
def ray(scene, o, d, t0, t1, side, level, spans):
    """The first hit of the ray o + t·d, (x, y, z), with the stack: (t, window), t = inf if there is none.

    ``side``: of the surface at t0 if the ray is over the terrain there (0 unknown). ``level``: where in the pyramids to
    begin. ``spans`` (W, 2): scratch.
    """
    floats = scene.floats
    a, b = clip(o[2], d[2], scene.low, scene.high, t0, t1)
    if a > t0:
        side = 1 if d[2] < 0.0 else -1
    began = a
    windows = floats.shape[0]
    inner = 0
    for w in range(windows):
        a, b = clip(o[0], d[0], floats[w, WEST], floats[w, EAST], a, b)
        a, b = clip(o[1], d[1], floats[w, NORTH], floats[w, SOUTH], a, b)
        if a > b:
            break
        spans[w, 0], spans[w, 1] = a, b
        inner = w + 1
    # A ray that comes in through a side wall may run above or below the surface.
    if inner > 0 and spans[0, 0] > began:
        side = 0
    for stretch in range(2 * inner - 1):
        w = stretch if stretch < inner else 2 * inner - 2 - stretch
        if stretch < inner:
            a, b = spans[w, 0], (spans[w + 1, 0] if w + 1 < inner else spans[w, 1])
        else:
            a, b = spans[w + 1, 1], spans[w, 1]
        if a >= b and windows > 1:
            continue
        t, side = cast(scene, w, o, d, a, b, side, level)
        if t < INF:
            return t, w
    return INF, -1


@kernel
def cast_rays(scene, origins, directions, t0, t1, out, which, first, last):
    """Rays [first, last) of arrays (n, 3); ``out`` float64 (n,): t (NaN: none), ``which`` int8 (n,): the window hit."""
    spans = np.empty((scene.ints.shape[0], 2))
    for i in range(first, last):
        o = origins[i, 0], origins[i, 1], origins[i, 2]
        d = directions[i, 0], directions[i, 1], directions[i, 2]
        t, w = ray(scene, o, d, t0, t1, 0, 6, spans)
        out[i] = t if t < INF else np.nan
        which[i] = w


@leaf
def finish(scene, pinhole, x0, x1, y0, y1, picture, spans):
    """Cast the rays that packets left."""
    o, d0, du, dv, t0, t1 = pinhole
    corner, out, which = picture
    for py in range(y0, y1):
        for px in range(x0, x1):
            w = which[py - corner[0], px - corner[1]]
            if w > ABOVE:
                continue
            side = 1 if w in (ABOVE, TIRED) else 0
            d = (
                d0[0] + px * du[0] + py * dv[0],
                d0[1] + px * du[1] + py * dv[1],
                d0[2] + px * du[2] + py * dv[2],
            )
            begin = max(t0, out[py - corner[0], px - corner[1]])
            t, w = ray(scene, (o[0], o[1], o[2]), d, begin, t1, side, 2, spans)
            out[py - corner[0], px - corner[1]] = t if t < INF else np.nan
            which[py - corner[0], px - corner[1]] = w


@kernel
def cast_pinhole(scene, pinhole, clear, x0, x1, y0, y1, picture):
    """Pixels [x0, x1) × [y0, y1) of a pinhole camera.

    ``clear``: the eye is known to be above the surface (or beside it), so that fronts may be pushed from there.

    (One function, though long: block and row narrow the same dozen numbers, which calls would pass on.)
    """
    floats = scene.floats
    o, d0, du, dv, _, t1 = pinhole
    corner, out, which = picture
    windows = floats.shape[0]
    top, left = corner
    spans = np.empty((windows, 2))
    state, codes = np.empty(5 * LANES), np.empty(LANES, np.int64)
    scratch = state, codes, np.empty((2, BLOCK_X * BLOCK_Y), np.int64)
    finest = floats[windows - 1, SCALE]
    # Beyond its farthest corner no ray is over the terrain.
    edge_x = max(abs(o[0] - floats[0, WEST]), abs(o[0] - floats[0, EAST]))
    edge_y = max(abs(o[1] - floats[0, NORTH]), abs(o[1] - floats[0, SOUTH]))
    edge = np.hypot(edge_x, edge_y) * (1.0 + 1e-9) + 1e-9
    # Along this direction the slope of an upright camera's rays is the same all along a row.
    length = np.hypot(du[0], du[1])
    gx, gy = (-du[1] / length, du[0] / length) if length > 0.0 else (1.0, 0.0)
    if gx * (d0[0] + x1 * du[0] + y0 * dv[0]) + gy * (d0[1] + x1 * du[1] + y0 * dv[1]) < 0.0:
        gx, gy = -gx, -gy
    for by in range(y0, y1, BLOCK_Y):
        for bx in range(x0, x1, BLOCK_X):
            ey, ex = min(by + BLOCK_Y, y1), min(bx + BLOCK_X, x1)
            if not clear:
                out[by - top : ey - top, bx - left : ex - left] = pinhole.near
                which[by - top : ey - top, bx - left : ex - left] = UNKNOWN
                finish(scene, pinhole, bx, ex, by, ey, picture, spans)
                continue
            a = least(counted() * LANES + bx, spread(ex - 1.0))
            b = least(a + (LANES - 1.0), spread(ex - 1.0))
            wanted = counted() * LANES + bx < ex
            wedged = not turns(d0, du, dv, gx, gy, bx, ex, by, ey) and grazes(d0, du, dv, gx, gy, bx, ex, by, ey)
            if wedged:
                beams, slope = wedges(d0, du, dv, gx, gy, a, b, by, ey)
                end, step = edge, spread(16.0 * finest)
            else:
                beams, slope = cones(d0, du, dv, a, b, by, ey)
                end, step = t1, 16.0 * finest / (most(size(beams.xa), size(beams.ya)) + 1e-300)
            first, step, _ = advance(scene, o, beams, slope, spread(0.0), end, step, spread(-INF), wanted, CELLS)
            if not some(wanted & (first < end)):
                out[by - top : ey - top, bx - left : ex - left] = np.nan
                which[by - top : ey - top, bx - left : ex - left] = -1
                continue
            front, tried, ground, lowest, fastest = first, step, spread(-INF), spread(-INF), spread(1.0)
            upward, many = False, 0
            if wedged:
                upper, _ = row_slope(d0, du, dv, gx, gy, bx, ex, by)
                lower, _ = row_slope(d0, du, dv, gx, gy, bx, ex, ey - 1)
                upward = upper >= lower
            for row in range(ey - by):
                py = ey - 1 - row if upward else by + row
                moving = wanted
                if wedged:
                    slope, fastest = row_slopes(d0, du, dv, gx, gy, a, b, py)
                    turned = slope < lowest  # a turned camera: this row does not see over the one before
                    front, tried = where(turned, first, front), where(turned, step, tried)
                    ground, lowest = where(turned, -INF, ground), slope
                    moving = wanted & (o[2] + where(slope >= 0.0, front, front + tried) * slope > ground)
                elif row % LOW == 0:
                    beams, slope = cones(d0, du, dv, a, b, py, min(py + LOW, ey))
                    front, tried = first, step
                if (wedged or row % LOW == 0) and some(moving):
                    front, tried, ground = advance(scene, o, beams, slope, front, end, tried, ground, moving, CELLS)
                store(state, FRONT, front)
                store(state, START, front / fastest)
                store(state, X, o[0] + 0.5 * front * (beams.xa + beams.xb))
                store(state, Y, o[1] + 0.5 * front * (beams.ya + beams.yb))
                many = cast_row(scene, pinhole, bx, ex, py, end, picture, scratch, many)
            for _ in range(ROUNDS):
                if many == 0:
                    break
                many = cast_further(scene, pinhole, picture, scratch, many)
            finish(scene, pinhole, bx, ex, by, ey, picture, spans)


@inlined
def cast_row(scene, pinhole, x0, x1, py, end, picture, scratch, many):
    """Walk the rays of a block's row from their fronts, and add those that have further to go to the ``many``."""
    floats = scene.floats
    o, d0, du, dv, t0, t1 = pinhole
    corner, out, which = picture
    state, codes, further = scratch
    row, left = py - corner[0], corner[1]
    for j in range((x1 - x0 + LANES - 1) // LANES):
        first, last = x0 + j * LANES, min(x0 + (j + 1) * LANES, x1)
        if state[FRONT + j] >= end:
            out[row, first - left : last - left] = np.nan
            which[row, first - left : last - left] = -1
            continue
        px = counted() + first
        dx, dy = px * du[0] + d0[0] + py * dv[0], px * du[1] + d0[1] + py * dv[1]
        dz = px * du[2] + d0[2] + py * dv[2]
        w, start = window_at(floats, state[X + j], state[Y + j]), spread(state[START + j])
        t, met = walk_packet(scene, w, o, dx, dy, dz, start, t0, t1, px < last, STEPS)
        store(state, T, t)
        store(codes, 0, met)
        for k in range(last - first):
            out[row, first + k - left], which[row, first + k - left] = state[T + k], codes[k]
        if some(((met == TIRED) | (met == ABOVE)) & (px < last)):
            for k in range(last - first):
                if codes[k] == TIRED or codes[k] == ABOVE:
                    further[0, many], further[1, many] = first + k, py
                    many += 1
    return many


@inlined
def cast_further(scene, pinhole, picture, scratch, many):
    """Push rays that have taken their steps, or left their window, to the next ground below them, and walk on.

    They are taken in eights wherever in the block they are; returns how many have still further to go.
    """
    floats = scene.floats
    o, d0, du, dv, t0, t1 = pinhole
    corner, out, which = picture
    state, codes, further = scratch
    left = 0
    for first in range(0, many, LANES):
        count = min(many - first, LANES)
        for k in range(LANES):
            px, py = further[0, first + min(k, count - 1)], further[1, first + min(k, count - 1)]
            state[X + k], state[Y + k], state[START + k] = px, py, out[py - corner[0], px - corner[1]]
        px, py, t = load(state, X), load(state, Y), load(state, START)
        wanted = counted() < count
        dx, dy = px * du[0] + d0[0] + py * dv[0], px * du[1] + d0[1] + py * dv[1]
        dz = px * du[2] + d0[2] + py * dv[2]
        step = FURTHER * floats[floats.shape[0] - 1, SCALE] / (most(size(dx), size(dy)) + 1e-300)
        start, _, _ = advance(scene, o, Beams(dx, dx, dy, dy), dz, t, t1, step, spread(-INF), wanted, FURTHER)
        x, y = o[0] + start * dx, o[1] + start * dy
        store(state, X, x)
        store(state, Y, y)
        w = window_at(floats, state[X], state[Y])  # the first ray's: those in other windows wait for their turn
        t, met = walk_packet(scene, w, o, dx, dy, dz, start, t0, t1, wanted, STEPS)
        beside = (met == BESIDE) & within((floats[0, WEST], floats[0, NORTH], floats[0, EAST], floats[0, SOUTH]), x, y)
        store(state, START, where((met == TIRED) | ((met == ABOVE) & (t > start)) | beside, 1.0, 0.0))
        store(state, T, t)
        store(codes, 0, where(met == BESIDE, ABOVE, met))
        for k in range(count):
            column, row = further[0, first + k], further[1, first + k]
            out[row - corner[0], column - corner[1]] = state[T + k]
            which[row - corner[0], column - corner[1]] = codes[k]
            if state[START + k] > 0.0:
                further[0, left], further[1, left] = column, row
                left += 1
    return left


@inlined
def window_at(floats, x, y):
    """The finest window that holds a place."""
    w = 0
    while w + 1 < floats.shape[0] and holds(floats, w + 1, x, y):
        w += 1
    return w


@inlined
def holds(floats, w, x, y):
    """Whether a window's rectangle holds a place."""
    return floats[w, WEST] <= x and x <= floats[w, EAST] and floats[w, NORTH] <= y and y <= floats[w, SOUTH]
