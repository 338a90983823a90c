"""Dividing the blocks of the screen between patches and rays: the cost of each way, and the cheaper division.

A patch costs what its triangles cost, however many blocks it lies over, and it is drawn if any of these is drawn by
patches; so what a block saves depends on its neighbours. First each block compares the cost of its rays with that of
its pixels and its share of the patches over it (their triangles are divided evenly). Then, while that pays, single
blocks switch to the other way, for what that saves while the others stay. Finally the whole picture is compared with
patches alone and rays alone. The previous way of each block has an advantage: the hysteresis. Nanoseconds, pixels,
blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Boxes = NDArray[np.int64]
"""(k, 4): the blocks that each patch lies over (``lod.patches.footprints``)."""
Labels = NDArray[np.bool_]
"""(down, across): whether rays draw a block."""

SWEEPS = 4
"""Maximum number of passes in which blocks switch to the other way."""

WORTH = 0.08
"""Fraction of the cost of the better way alone that mixing must save: costs are estimates."""


class Costs(NamedTuple):
    """The costs of drawing on a device.

    Attributes:
        triangle, pixel: ns of patches, each triangle, and each pixel that they cover. ray, step: ns of rays, each that
            meets ground, and each step of any. begin: ns before any ray (``rays.Beams``). both: ns that a picture of
            both ways takes in addition.
    """

    triangle: float
    pixel: float
    ray: float
    step: float
    begin: float
    both: float


STATED = Costs(triangle=150.0, pixel=60.0, ray=65.0, step=24.0, begin=0.0, both=0.0)
"""Those of software on two cores: pictures that are waited for go by them, so that they are the same each time."""


class Frame(NamedTuple):
    """What a frame has to draw.

    Attributes:
        boxes: of the patches. triangles: of each patch. pixels: (down, across), of the blocks.
        ground: (down, across), those of them that show ground. steps: (down, across), of all rays through a block.
    """

    boxes: Boxes
    triangles: int
    pixels: Array
    ground: Array
    steps: Array


class Shares(NamedTuple):
    """Who draws what.

    Attributes:
        by_rays: ``Labels``. cost: expected, ns; patches, rays: that of either alone.
        gain: what blocks could save by rays, at most, if patches drew all others.
    """

    by_rays: Labels
    cost: float
    patches: float
    rays: float
    gain: float


def over_blocks(boxes: Boxes, values: Array, shape: tuple[int, int]) -> Array:
    """The sum of the values of the patches over each block."""
    down, across = shape
    x0, y0, x1, y1 = boxes.T
    there = (x1 > x0) & (y1 > y0)
    wide = across + 1
    ends = [y0 * wide + x0, y1 * wide + x1, y0 * wide + x1, y1 * wide + x0]
    size = (down + 1) * wide
    a, b, c, d = (np.bincount(end[there], values[there], size) for end in ends)
    summed: Array = (a + b - c - d).reshape(down + 1, wide).cumsum(0).cumsum(1)[:down, :across]
    return summed


def count_over(boxes: Boxes, labels: Labels) -> NDArray[np.int64]:
    """The number of labelled blocks that each patch lies over."""
    sums = np.zeros((labels.shape[0] + 1, labels.shape[1] + 1), np.int64)
    np.cumsum(np.cumsum(labels, 0), 1, out=sums[1:, 1:])
    x0, y0, x1, y1 = boxes.T
    found: NDArray[np.int64] = sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    return np.where((x1 > x0) & (y1 > y0), found, 0)


def kept(boxes: Boxes, by_rays: Labels) -> Labels:
    """(k,): whether a patch is drawn, that is, lies over a block of patches."""
    return count_over(boxes, ~by_rays) > 0


def share(frame: Frame, costs: Costs, hysteresis: float, before: Labels | None = None) -> Shares:
    """Divide the blocks between patches and rays.

    Args:
        hysteresis: fraction of a block's cost by which the other way has to be cheaper. before: the last division.
    """
    boxes, shape = frame.boxes, frame.pixels.shape
    blocks = np.maximum(boxes[:, 2] - boxes[:, 0], 0) * np.maximum(boxes[:, 3] - boxes[:, 1], 0)
    each = costs.triangle * frame.triangles
    rays, ground = costs.ray * frame.ground + costs.step * frame.steps, costs.pixel * frame.ground
    parts = over_blocks(boxes, each / np.maximum(blocks, 1), shape) + ground
    stay = 1.0 if before is None else np.where(before, 1.0 + hysteresis, 1.0 - hysteresis)
    labels = rays < stay * parts
    least = 1.0 if before is None else 1.0 - hysteresis

    def total(labels: Labels) -> float:
        drawn = int(np.count_nonzero(kept(boxes, labels)))
        extra = costs.begin * labels.any() + costs.both * (labels.any() and not labels.all())
        return float(each * drawn + np.where(labels, rays, ground).sum() + extra)

    cost = total(labels)
    for _ in range(SWEEPS):
        waits = count_over(boxes, ~labels)  # blocks that require each patch
        alone = each * over_blocks(boxes, (waits == 1) * 1.0, shape)
        again = each * over_blocks(boxes, ((waits == 0) & (blocks > 0)) * 1.0, shape)
        turned = np.where(labels, ~(ground + again < least * rays), rays < least * (ground + alone))
        then = total(turned)
        if not then < cost:
            break
        labels, cost = turned, then
    by_patches, all_rays = float(each * np.count_nonzero(blocks) + ground.sum()), float(rays.sum()) + costs.begin
    alone_before = None if before is None or before.any() != before.all() else bool(before.all())
    one = bool(all_rays < {None: 1.0, False: 1.0 - hysteresis, True: 1.0 + hysteresis}[alone_before] * by_patches)
    worth = WORTH if before is None else WORTH * (1.5 if one == alone_before else 0.5)
    least_alone = all_rays if one else by_patches
    if not cost < (1.0 - worth) * least_alone:
        labels, cost = np.full(shape, one), least_alone
    return Shares(labels, cost, by_patches, all_rays, float(np.maximum(parts - rays, 0.0).sum()))
