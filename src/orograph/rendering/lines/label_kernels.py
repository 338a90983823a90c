"""The inner loops of labels on contour lines: how each would lie on the screen, which may stand, and their type."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel


@kernel
def ramp(low, high, x):
    """0 below ``low``, 1 above ``high``, smooth between."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel
def _along(line, middle, side, length, out):
    """The point at ``length`` pixels from the middle of a line (points, 2), to one side; whether it reaches so far."""
    gone = 0.0
    k = middle
    while 0 <= k + side < len(line):
        dx, dy = line[k + side, 0] - line[k, 0], line[k + side, 1] - line[k, 1]
        step = np.sqrt(dx * dx + dy * dy)
        if not step < 1e6:  # a point behind the eye
            return False
        if gone + step >= length:
            f = (length - gone) / max(step, 1e-9)
            out[0], out[1] = line[k, 0] + f * dx, line[k, 1] + f * dy
            return True
        gone += step
        k += side
    return False


@kernel
def lie(lines, widths, tall, places, bends):
    """How labels lie along lines on the screen.

    Args:
        lines: (n, points, 2) pixels, the label's place in the middle. widths: (n,) of the labels, tall: their height.
        places: out (n, 3): middle x, y and angle (radians, x to the right, y down; never upside down).
        bends: out (n,): how far the line goes aside under the label, as a part of its height; inf: it is too short.
    """
    a, b = np.empty(2), np.empty(2)
    middle = lines.shape[1] // 2
    for i in range(len(lines)):
        bends[i] = np.inf
        half = 0.5 * widths[i] + 0.35 * tall
        if not (_along(lines[i], middle, -1, half, a) and _along(lines[i], middle, 1, half, b)):
            continue
        dx, dy = b[0] - a[0], b[1] - a[1]
        size = np.sqrt(dx * dx + dy * dy)
        if size < 1.4 * half:
            continue
        dx, dy = dx / size, dy / size
        most, least = 0.0, 0.0
        for k in range(lines.shape[1]):
            px, py = lines[i, k, 0] - a[0], lines[i, k, 1] - a[1]
            t = px * dx + py * dy
            if 0.0 <= t <= size:
                aside = px * dy - py * dx
                most, least = max(most, aside), min(least, aside)
        mid = 0.5 * (most + least)
        if dx < -1e-9 or (abs(dx) <= 1e-9 and dy > 0.0):  # upright labels read upwards
            angle = np.arctan2(-dy, -dx)
        else:
            angle = np.arctan2(dy, dx)
        places[i, 0] = 0.5 * (a[0] + b[0]) + mid * dy
        places[i, 1] = 0.5 * (a[1] + b[1]) - mid * dx
        places[i, 2] = angle
        bends[i] = (most - least) / tall


@kernel
def stand(order, places, widths, values, opacity, apart, same):
    """Which labels may stand beside each other: ``opacity`` (n,) is lessened, in the order of their rank.

    Args:
        order: (n,) indices, the first rank first. values: what they say.
        apart: pixels between the ends of any two. same: pixels between the middles of two that say the same.
    """
    shown = np.empty(len(order), np.int64)
    count = 0
    for o in range(len(order)):
        i = order[o]
        left = opacity[i]
        for s in range(count):
            j = shown[s]
            dx, dy = places[i, 0] - places[j, 0], places[i, 1] - places[j, 1]
            distance = np.sqrt(dx * dx + dy * dy)
            need = apart + 0.5 * (widths[i] + widths[j])
            if values[i] == values[j]:
                need = max(need, same)
            if distance < need:
                left *= 1.0 - opacity[j] * (1.0 - ramp(0.92 * need, need, distance))
                if left < 0.02:
                    break
        opacity[i] = left if left >= 0.02 else 0.0
        if opacity[i] > 0.0:
            shown[count] = i
            count += 1


@kernel
def set_labels(places, opacity, first, shapes, pool, scale, left, top, out):
    """Set type on a sheet.

    Args:
        places: (n, 3) middle x, y (pixels of the whole picture) and angle. opacity: (n,).
        first, shapes: where each label's type begins in ``pool`` (uint8: ink and halo by turns), and its (rows, cols),
            ``scale`` of them a pixel.
        left, top: the sheet's first pixel. out: (rows, cols, 2) uint8: ink and halo; added to.
    """
    rows, cols = out.shape[0], out.shape[1]
    for i in range(len(places)):
        if opacity[i] <= 0.0:
            continue
        tall, wide = shapes[i, 0], shapes[i, 1]
        c, s = np.cos(places[i, 2]), np.sin(places[i, 2])
        half_w, half_h = 0.5 * wide / scale, 0.5 * tall / scale
        reach_x = abs(c) * half_w + abs(s) * half_h + 1.0
        reach_y = abs(s) * half_w + abs(c) * half_h + 1.0
        mx, my = places[i, 0], places[i, 1]
        for y in range(max(int(np.floor(my - reach_y)), top), min(int(np.ceil(my + reach_y)) + 1, top + rows)):
            for x in range(max(int(np.floor(mx - reach_x)), left), min(int(np.ceil(mx + reach_x)) + 1, left + cols)):
                # (Counted from the whole picture's corner, so that every sheet has the same numbers.)
                dx, dy = x + 0.5 - mx, y + 0.5 - my
                u, v = c * dx + s * dy, c * dy - s * dx
                fx, fy = u * scale + 0.5 * wide - 0.5, v * scale + 0.5 * tall - 0.5
                ix, iy = int(np.floor(fx)), int(np.floor(fy))
                fx, fy = fx - ix, fy - iy
                ink, halo = 0.0, 0.0
                for ky in range(2):
                    for kx in range(2):
                        if 0 <= iy + ky < tall and 0 <= ix + kx < wide:
                            w = (fy if ky else 1.0 - fy) * (fx if kx else 1.0 - fx)
                            at = first[i] + 2 * ((iy + ky) * wide + ix + kx)
                            ink += w * pool[at]
                            halo += w * pool[at + 1]
                row, col = y - top, x - left
                out[row, col, 0] = max(out[row, col, 0], np.uint8(ink * opacity[i]))
                out[row, col, 1] = max(out[row, col, 1], np.uint8(halo * opacity[i]))
