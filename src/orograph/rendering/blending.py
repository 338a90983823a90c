"""Blend several pictures of a scene, each with its own priority: focus and context, changing scenarios.

A scene's variants are drawn with the same camera, blended in linear light by their weights at each pixel, and furnished
as one picture. A variant with no weight anywhere is not drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError
from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.layers import drawn as visible
from orograph.rendering.describing import describe
from orograph.rendering.furniture.furnish import furnish
from orograph.rendering.furniture.legend import Drawn, furniture_of, sampled
from orograph.rendering.inset import inset_of
from orograph.rendering.picture import Picture
from orograph.scene.ghosts import Seen
from orograph.scene.scene import Scene

Draw = Callable[[Scene], Picture]
LEAST = 1 / 512
"""Smaller weights of a variant are ignored."""


def blended(
    scene: Scene, draw: Draw, others: Callable[[int], Draw], warn: Callable[[str], None] | None = None
) -> Picture:  # fmt: skip
    """The picture of a scene with its variants.

    Args:
        draw: draws the scene without them. others: draws the variant with a number.
        warn: called if a focus is not visible anywhere; None: not reported, as for a film's frames.
    """
    whole = scene.view.part is None
    bare = replace(scene, variants=())
    picture = draw(bare.but(furniture=False, title=None) if whole else bare)
    pixels = mixed(scene, picture, others, warn)
    if whole and scene.annotations.furniture:
        pixels = _furnished(scene, picture, pixels, draw)
    return replace(picture, pixels=pixels, facts={**picture.facts, "description": describe(scene)})


def mixed(
    scene: Scene, picture: Picture, others: Callable[[int], Draw], warn: Callable[[str], None] | None = None
) -> NDArray[np.uint8]:
    """The pixels of a scene's picture with its variants; arguments as for ``blended``."""
    whole, linear = scene.view.part is None, None
    for number, variant in enumerate(scene.variants):
        weight = variant.weight(*_seen(picture))
        if not (weight > LEAST).any():
            if warn is not None and variant.name == "focus":
                warn(_nowhere(picture))
            continue
        try:
            other = others(number)(variant.scene.but(furniture=False, title=None) if whole else variant.scene)
        except NothingInViewError:
            if not isinstance(variant.weight, Seen):
                raise
            continue  # a ghost need not be in every view
        if isinstance(variant.weight, Seen):
            weight = variant.weight.of_depths(picture.depth, other.depth, other.places())
        part = weight[..., None].astype(np.float32)
        linear = _linear(picture.pixels) if linear is None else linear
        linear = linear * (1 - part) + _linear(other.pixels) * part
    return picture.pixels if linear is None else np.rint(linear_to_srgb(linear) * 255).astype(np.uint8)


def _nowhere(picture: Picture) -> str:
    far = np.linalg.norm(picture.places() - np.asarray(picture.view.eye), axis=-1)
    return f"The focus is not visible in this picture, whose nearest ground is {np.nanmin(far):,.0f} m from the eye."


def _linear(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(srgb_to_linear(pixels.astype(np.float32) / 255), np.float32)


def _seen(picture: Picture) -> tuple[Any, Any, tuple[Any, Any], float]:
    """The inputs of weights: the eye, places, pixels, the whole picture's aspect."""
    view = picture.view
    whole = view.whole
    left, top, _, _ = view.frame
    x = (left + np.arange(view.width) + 0.5) / whole.height
    y = (top + np.arange(view.height) + 0.5) / whole.height
    return np.asarray(view.eye, np.float64), picture.places(), (x, y), whole.width / whole.height


def _furnished(scene: Scene, picture: Picture, pixels: NDArray[np.uint8], draw: Draw) -> NDArray[np.uint8]:
    assert picture.tint is not None
    depth = picture.depth.astype(np.float64)
    seen = sampled(depth, *depth.shape), depth[:, depth.shape[1] // 2]
    about = Drawn(picture.tint, picture.facts["shown"], bool(visible(scene.data.layers)), *seen)
    ground = np.isfinite(depth) | (False if picture.void_filled is None else picture.void_filled)
    pieces = furniture_of(scene, about) | {"inset": inset_of(replace(scene, variants=()), draw)}
    return furnish(pixels, **pieces, ground=ground)
