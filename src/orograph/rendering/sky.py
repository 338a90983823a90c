"""The sky behind the terrain and the air in front of it, in display-linear light.

The sky is ``scattering``'s clear one (Hillaire 2020), as seen from the ground wherever the camera stands: a picture of
a whole mountain range is a view of a model, and the black of space beside it would say nothing. It is exposed as an
eye adapts: at a high sun its mean brightness is ``BRIGHTNESS`` (white, that is level ground of albedo 1 in full sun at
45°, is 1), in twilight less. Beneath the horizon, where no terrain is, the horizon's haze goes on, calming to a mist.

Aerial perspective: extinction and in-scattering along the ray (Koschmieder 1924), stronger for short waves by
Ångström's law λ^−α. The part of the colour that is lost is replaced by the sky at the horizon in that direction. Its
strength comes from the depths in view, not from the weather: the farthest ground loses ``LOSS`` · (1 − near / far)^1.5
of its green light, and the air before the nearest ground is left out. So any scene gets a cue of depth and none gets
fog: a panorama from within has it all, a terrain looked at from outside, whose ends are about as far away, little.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph.memo import Memo
from orograph.rendering.scattering import (
    AZIMUTHS,
    ELEVATIONS,
    OBSERVER,
    grid_lookup,
    mie_phase,
    optical_depth,
    sky_table,
)
from orograph.scene.scene import Scene

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

BRIGHTNESS = 0.46
"""Mean luminance of the upper half of the sky, weighted by the cosine from the zenith, before the tone curve."""

LOSS = 0.42
"""Green light lost over the depth in view, if that begins at the eye."""

WAVELENGTHS = np.array([610.0, 550.0, 465.0])
ANGSTROM = 1.6
"""Exponent of extinction over wavelength: 4 for pure air, about 1 for haze."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
MIST = 0.85
"""Brightness of the mist beneath the horizon against the sky 2° to 15° above it, away from the sun."""

FADE = 4.0
"""How fast the horizon turns to mist: by a factor of e in asin(1 / FADE)."""

CROSSTALK = 0.1
"""Share of each channel's light that goes to grey, as in film: keeps bright low suns from turning lemon yellow."""

BLOCK = 1 << 15
"""Directions at a time: what fits into the processor's cache."""

DISC = 12.0
"""Radiance of the sun's disc outside the air (the tone curve makes it white, or red when it is low)."""


class Atmosphere:
    """Sky and haze of one scene. All methods may be called from several threads.

    Attributes:
        table: (rows, cols, 6) exposed radiance of air and haze, by elevation and azimuth from the sun (``sky_table``).
        ring: (257, 3) colours of the horizon by sin(φ / 2), φ the azimuth from the sun's. mist: (3,) beneath it.
        disc: (3,) radiance of the sun's disc. side: (2,) horizontal direction towards the sun.
        near: depth where the air begins, metres.
    """

    def __init__(self, scene: Scene, visible_range: tuple[float, float], memo: Memo | None = None) -> None:
        """
        Args:
            scene: only its sun is used.
            visible_range: view-space depths of the nearest and the farthest ground in view, metres.
            memo: cached from earlier pictures.
        """
        memo = Memo() if memo is None else memo
        azimuth, altitude = math.radians(scene.lighting.sun.azimuth), math.radians(scene.lighting.sun.altitude)
        self._radius = math.radians(scene.lighting.sun.diameter) / 2
        self.side = np.array([math.sin(azimuth), math.cos(azimuth)], np.float32)
        self._sun = np.array(
            [*(self.side * math.cos(altitude)), math.sin(altitude)], np.float32
        )  # fmt: skip
        air, haze = memo("air", altitude, lambda: tuple(_greyed(part) for part in sky_table(altitude)))
        exposure = adapted(scene.lighting.sun.altitude) / _mean(air, haze, altitude)
        self.table = np.concatenate([air, haze], 2).astype(np.float32) * np.float32(exposure)
        through = np.exp(-optical_depth(OBSERVER, max(math.sin(altitude), 0.0)))
        self.disc = (DISC * _greyed(through)).astype(np.float32)
        around = np.linspace(0.0, 1.0, 257)
        cosine = 1.0 - 2.0 * around**2
        ring = np.stack([cosine, np.sqrt(1.0 - cosine**2), np.zeros(257)], 1)
        # The frame of the ring is turned to the sun: x towards its azimuth.
        turn = np.array([[self.side[0], self.side[1], 0], [-self.side[1], self.side[0], 0], [0, 0, 1]])
        low = self.table[ELEVATIONS // 6 : ELEVATIONS // 2, AZIMUTHS * 2 // 3 :, :3].mean((0, 1))
        self.mist = _tone((low + low.mean()) * np.float32(MIST / 2))
        self.ring = _tone(self._above((ring @ turn).astype(np.float32)))
        near, far = max(float(visible_range[0]), 0.0), float(visible_range[1])
        self.near = near
        loss = LOSS * (1.0 - near / far) ** 1.5 if far > near else 0.0
        per_metre = -math.log1p(-loss) / (far - near) if loss > 0 else 0.0
        self.extinction = (per_metre * (WAVELENGTHS / WAVELENGTHS[1]) ** -ANGSTROM).astype(np.float32)
        """Extinction coefficients of red, green and blue, per metre."""

    def sky(self, directions: Array) -> Colors:
        """Linear colours (n, 3) of the background in unit directions (n, 3): x east, y north, z up."""
        if len(directions) > BLOCK:
            parts = range(0, len(directions), BLOCK)
            return np.concatenate([self.sky(directions[i : i + BLOCK]) for i in parts])
        d = np.asarray(directions, np.float32)
        out = _tone(self._above(d, disc=True))
        down = np.minimum(d[:, 2], 0.0)
        if down.any():
            # The table's lowest row went on beneath the horizon; it fades into the mist.
            out += (self.mist - out) * -np.expm1(down * np.float32(FADE))[:, None]
        return out

    def horizon(self, directions: NDArray[np.floating]) -> Colors:
        """Linear colours (n, 3) of the sky at the horizon under or above directions (n, 3)."""
        d = np.asarray(directions, np.float32)
        t = self._around(d) * np.float32(256)
        k = np.minimum(t.astype(np.int32), 255)
        low = self.ring.take(k, 0)
        out: Colors = low + (self.ring.take(k + 1, 0) - low) * (t - k)[:, None]
        return out

    def haze(self, color: Colors, directions: Array, depth: NDArray[np.floating]) -> Colors:
        """The remaining linear colours (n, 3) of ground at ``depth`` (n,) metres, and the air's light in front of
        it."""
        if len(color) == 0 or not self.extinction.any():
            return np.asarray(color, np.float32)
        path = np.maximum(depth - self.near, 0.0).astype(np.float32)
        left = np.exp(path[:, None] * -self.extinction)
        air = self.horizon(directions)
        out: Colors = air + (color - air) * left
        return out

    def _around(self, d: NDArray[np.float32]) -> NDArray[np.float32]:
        """sin(φ / 2) of the azimuth φ between directions and the sun."""
        level = np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1])
        cosine = (d[:, 0] * self.side[0] + d[:, 1] * self.side[1]) / np.maximum(level, np.float32(1e-12))
        half: NDArray[np.float32] = np.sqrt(np.clip(np.float32(0.5) - np.float32(0.5) * cosine, 0.0, 1.0))
        return half

    def _above(self, d: NDArray[np.float32], disc: bool = False) -> Colors:
        """Radiance of the sky in directions at or above the horizon, before the tone curve."""
        z = np.clip(d[:, 2], 0.0, 1.0)
        both = grid_lookup(
            self.table, np.sqrt(z) * np.float32(ELEVATIONS - 1), self._around(d) * np.float32(AZIMUTHS - 1)
        )
        # Not by a product of matrices: its last digit depends on where in the array a direction stands.
        cosine = d[:, 0] * self._sun[0] + d[:, 1] * self._sun[1] + d[:, 2] * self._sun[2]
        out: Colors = both[:, 3:] * mie_phase(cosine)[:, None]
        out += both[:, :3]
        if disc and self._radius > 0 and self._sun[2] > -self._radius:
            close = np.flatnonzero((d[:, 2] >= 0) & (cosine > math.cos(2 * self._radius + 1e-3)))
            if len(close):
                # float32 cosines cannot tell such small angles: the length of the difference can.
                angle = 2 * np.arcsin(np.linalg.norm(d[close] - self._sun, axis=1) / 2)
                out[close] += (
                    np.clip((self._radius - angle) / (0.1 * self._radius) + 0.5, 0.0, 1.0)[:, None] * self.disc
                )
        return out


def dithered(colors: Colors, px: Array, py: Array) -> Colors:
    """Linear colours (n, 3) at pixel positions (n,), moved by up to half a step of what a byte of sRGB can tell: a sky
    and ground whose colour changes by less than a step over many pixels have no bands then (ordered dither, Bayer 1973,
    8 × 8)."""
    x, y = np.floor(px).astype(np.int64), np.floor(py).astype(np.int64)
    rank = np.zeros(len(x), np.int64)
    for k in range(3):
        u, v = (x >> k) & 1, (y >> k) & 1
        rank |= ((u ^ v) << (5 - 2 * k)) | (v << (4 - 2 * k))
    aside = ((rank + 0.5) / 64 - 0.5).astype(np.float32)
    step = np.float32(2.4 / 1.055 / 255) * np.maximum(colors, np.float32(1e-3)) ** np.float32(1.4 / 2.4)
    return np.asarray(colors + aside[:, None] * step, np.float32)


def adapted(altitude: float) -> float:
    """Mean brightness of the sky on the display, sun at ``altitude`` degrees: a fifth of the day's at civil dusk."""
    day = 1.0 / (1.0 + math.exp(-(altitude + 1.5) / 2.2))
    return BRIGHTNESS * (0.06 + 0.94 * day)


def _rows() -> Array:
    return np.linspace(0.0, 1.0, ELEVATIONS) ** 2


def _mean(air: Array, haze: Array, altitude: float) -> float:
    """Luminance of the sky's upper half, weighted by the cosine from the zenith (that is, its illuminance / π)."""
    z = _rows()[:, None]
    half = np.linspace(0.0, 1.0, AZIMUTHS)[None, :]
    towards = z * math.sin(altitude) + np.sqrt(1 - z * z) * (1 - 2 * half**2) * math.cos(altitude)
    luminance = (air + haze * mie_phase(towards)[..., None]) @ LUMINANCE
    azimuth = 2 * np.arcsin(half)
    over_azimuth = np.trapezoid(luminance, azimuth, axis=1) / math.pi
    return float(np.trapezoid(over_azimuth * 2 * z[:, 0], z[:, 0])) + 1e-9


def _greyed(light: Array) -> Array:
    return np.asarray(light + CROSSTALK * (light.mean(-1, keepdims=True) - light))


def _tone(radiance: Colors) -> Colors:
    """Radiance → display-linear light in [0, 1): 1 − e^{−x}, in place."""
    np.negative(radiance, out=radiance)
    np.expm1(radiance, out=radiance)
    np.negative(radiance, out=radiance)
    return radiance
