"""Radiance of a clear sky seen from the ground: scattered sunlight in a round atmosphere, tabulated for one sun.

Air (Rayleigh), haze (Mie) and ozone as in Hillaire, "A Scalable and Production Ready Sky and Atmosphere Rendering
Technique" (Computer Graphics Forum 39(4), 2020), with its coefficients of air and ozone for red, green and blue:
light scattered once is integrated along each ray with the transmittance from a table; light scattered more often comes
from the same paper's isotropic closed sum, Ψ = L₂ / (1 − f). The round Earth makes twilight come out by itself. What
is smooth (the integrals) is tabulated over directions; the haze's peaked phase function multiplies them afterwards.

Units: kilometres, radians; radiance for a sun of illuminance 1 outside the air, in each of the three channels.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

GROUND = 6360.0
TOP = 6460.0
RAYLEIGH = np.array([5.802e-3, 13.558e-3, 33.1e-3])
RAYLEIGH_HEIGHT = 8.0
MIE = 30e-3
MIE_EXTINCTION = 32.6e-3
"""Optical depth 0.04: a clear day, brighter around the sun, as the CIE's clear skies are (Hillaire's has 0.01)."""
MIE_HEIGHT = 1.2
MIE_G = 0.72
OZONE = np.array([0.650e-3, 1.881e-3, 0.085e-3])
ALBEDO = 0.3
"""Albedo of the surrounding ground, for the light it reflects into the air."""

OBSERVER = 0.5
"""Height of the observer."""

ELEVATIONS, AZIMUTHS = 72, 33


def densities(height: Array) -> tuple[Array, Array, Array]:
    """Densities of air, haze and ozone relative to their reference, at heights in km."""
    h = np.maximum(height, 0.0)
    return np.exp(-h / RAYLEIGH_HEIGHT), np.exp(-h / MIE_HEIGHT), np.maximum(0.0, 1.0 - np.abs(h - 25.0) / 15.0)


def extinction(height: Array) -> Array:
    """Extinction (…, 3) per km at heights in km."""
    air, haze, ozone = densities(height)
    return np.asarray(air[..., None] * RAYLEIGH + haze[..., None] * MIE_EXTINCTION + ozone[..., None] * OZONE)


def to_top(r: Array, mu: Array) -> Array:
    """Distance from radius ``r`` to the top of the atmosphere, along a ray at cosine ``mu`` from the vertical."""
    return np.asarray(-r * mu + np.sqrt(np.maximum(r * r * (mu * mu - 1.0) + TOP * TOP, 0.0)))


def horizon(r: Array) -> Array:
    """Cosine from the vertical of the ray that grazes the ground, seen from radius ``r``."""
    return np.asarray(-np.sqrt(np.maximum(1.0 - (GROUND / np.maximum(r, GROUND)) ** 2, 0.0)))


def optical_depth(height: ArrayLike, mu: ArrayLike, steps: int = 64) -> Array:
    """Optical depth (…, 3) from ``height`` (km) to the top, along rays that do not meet the ground."""
    r, mu = np.broadcast_arrays(np.asarray(height, np.float64) + GROUND, np.asarray(mu, np.float64))
    length = to_top(r, mu)
    edges = np.linspace(0.0, 1.0, steps + 1) ** 2
    total = np.zeros((*r.shape, 3))
    for a, b in pairwise(edges):
        s = length * (a + b) / 2
        radius = np.sqrt(r * r + s * s + 2 * r * mu * s)
        total += extinction(radius - GROUND) * (length * (b - a))[..., None]
    return total


def grid_lookup(table: NDArray[np.floating], u: NDArray[np.floating], v: NDArray[np.floating]) -> NDArray[np.floating]:
    """Bilinear values (n, c) of ``table`` (rows, cols, c) at fractional positions row ``u``, column ``v`` inside it."""
    rows, cols, channels = table.shape
    i = np.minimum(u.astype(np.int32), rows - 2)
    j = np.minimum(v.astype(np.int32), cols - 2)
    fu, fv = (u - i)[:, None], (v - j)[:, None]
    flat = table.reshape(-1, channels)
    k = i * cols + j
    low = flat.take(k, 0)
    low += (flat.take(k + 1, 0) - low) * fv
    k += cols
    high = flat.take(k, 0)
    high += (flat.take(k + 1, 0) - high) * fv
    high -= low
    high *= fu
    high += low
    return np.asarray(high)


class Transmittance:
    """Fraction of sunlight (n, 3) that reaches a height (km) from a sun at cosine ``mu``; none through the ground."""

    HEIGHTS, COSINES = 32, 64

    def __init__(self) -> None:
        h = (np.linspace(0.0, 1.0, self.HEIGHTS) ** 2 * (TOP - GROUND))[:, None]
        low = horizon(h + GROUND)
        self.table = optical_depth(h, low + np.linspace(0.0, 1.0, self.COSINES) ** 2 * (1.0 - low))

    def __call__(self, height: Array, mu: Array) -> Array:
        h = np.clip(height, 0.0, TOP - GROUND).ravel()
        low = horizon(h + GROUND)
        above = mu.ravel() - low
        u = np.sqrt(h / (TOP - GROUND)) * (self.HEIGHTS - 1)
        v = np.sqrt(np.clip(above / (1.0 - low), 0.0, 1.0)) * (self.COSINES - 1)
        through = np.exp(-grid_lookup(self.table, u, v))
        # The disc sinks behind the horizon over its own half degree.
        through *= np.clip(above / 0.0047 * 0.5 + 0.5, 0.0, 1.0)[:, None]
        return np.asarray(through.reshape(*height.shape, 3))


class ManyTimes:
    """Hillaire's Ψ (n, 3): isotropic radiance of light scattered twice or more, by height (km) and the sun's cosine."""

    HEIGHTS, COSINES = 8, 20

    def __init__(self, transmittance: Transmittance) -> None:
        h = np.linspace(0.0, 1.0, self.HEIGHTS)[:, None, None] ** 2 * (TOP - GROUND)
        h[0] = 0.05
        sun = np.linspace(-0.35, 1.0, self.COSINES)[None, :, None]
        k = np.arange(32) + 0.5
        z, phi = 1.0 - 2.0 * k / len(k), k * np.pi * (3.0 - np.sqrt(5.0))  # an even spiral of directions
        across = np.sqrt(1.0 - z * z) * np.cos(phi)
        r = h + GROUND
        down = z < horizon(r)
        length = np.where(down, -r * z - np.sqrt(np.maximum(r * r * (z * z - 1.0) + GROUND**2, 0.0)), to_top(r, z))
        length = np.broadcast_to(length, (self.HEIGHTS, self.COSINES, len(k)))
        edges = np.linspace(0.0, 1.0, 13) ** 2
        depth = np.zeros((*length.shape, 3))
        second, factor = np.zeros_like(depth), np.zeros_like(depth)
        beside = np.sqrt(np.maximum(1.0 - sun * sun, 0.0))
        for a, b in pairwise(edges):
            s = length * (a + b) / 2
            radius = np.sqrt(r * r + s * s + 2 * r * z * s)
            mu = (r * sun + s * (z * sun + across * beside)) / radius
            air, haze, _ = densities(radius - GROUND)
            scatter = air[..., None] * RAYLEIGH + haze[..., None] * MIE
            step = (length * (b - a))[..., None]
            here = extinction(radius - GROUND) * step
            weight = np.exp(-depth - here / 2) * scatter * step
            second += weight * transmittance(radius - GROUND, mu) / (4 * np.pi)
            factor += weight
            depth += here
        mu = np.broadcast_to((r * sun + length * (z * sun + across * beside)) / GROUND, length.shape)
        ground = ALBEDO / np.pi * np.maximum(mu, 0.0)[..., None] * transmittance(np.zeros_like(mu), mu)
        second += np.where(down[..., None], np.exp(-depth) * ground, 0.0)
        self.table = second.mean(2) / (1.0 - factor.mean(2))

    def __call__(self, height: Array, mu: Array) -> Array:
        u = np.sqrt(np.clip(height, 0.0, TOP - GROUND).ravel() / (TOP - GROUND)) * (self.HEIGHTS - 1)
        v = (np.clip(mu.ravel(), -0.35, 1.0) + 0.35) / 1.35 * (self.COSINES - 1)
        return np.asarray(grid_lookup(self.table, u, v).reshape(*height.shape, 3))


def sky_table(altitude: float) -> tuple[Array, Array]:
    """The sky's smooth parts over directions, for a sun at ``altitude`` (radians), seen from ``OBSERVER`` km.

    Returns:
        air (ELEVATIONS, AZIMUTHS, 3): radiance scattered by air once, by anything more than once;
        haze (…): radiance scattered once by haze, to be multiplied by ``mie_phase``.
        Row i is at sin(elevation) = (i / (ELEVATIONS − 1))², column j at sin(φ / 2) = j / (AZIMUTHS − 1), with φ the
        azimuth away from the sun's.
    """
    transmittance = Transmittance()
    often = ManyTimes(transmittance)
    z = (np.linspace(0.0, 1.0, ELEVATIONS) ** 2)[:, None]
    cosine = 1.0 - 2.0 * np.linspace(0.0, 1.0, AZIMUTHS)[None, :] ** 2
    sun, beside = np.sin(altitude), np.cos(altitude)
    towards = z * sun + np.sqrt(1.0 - z * z) * cosine * beside
    r = GROUND + OBSERVER
    length = to_top(np.full_like(towards, r), np.broadcast_to(z, towards.shape))
    edges = np.linspace(0.0, 1.0, 33) ** 2
    depth = np.zeros((*towards.shape, 3))
    air, haze = np.zeros_like(depth), np.zeros_like(depth)
    rayleigh = (3.0 / (16.0 * np.pi) * (1.0 + towards**2))[..., None] * RAYLEIGH
    for a, b in pairwise(edges):
        s = length * (a + b) / 2
        radius = np.sqrt(r * r + s * s + 2 * r * z * s)
        h = radius - GROUND
        mu = (r * sun + s * towards) / radius
        d_air, d_haze, _ = densities(h)
        step = (length * (b - a))[..., None]
        here = extinction(h) * step
        # Within a step the light fades as well: the exact mean of e^{−τ} over it.
        weight = np.exp(-depth) * -np.expm1(-here) / np.maximum(here, 1e-12) * step
        lit = weight * transmittance(h, mu)
        scatter = d_air[..., None] * RAYLEIGH + d_haze[..., None] * MIE
        air += lit * d_air[..., None] * rayleigh + weight * scatter * often(h, mu)
        haze += lit * d_haze[..., None] * MIE
        depth += here
    return air, haze


def mie_phase(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """The haze's phase function at the cosine of the scattering angle (Cornette and Shanks 1992, g = ``MIE_G``)."""
    g = MIE_G
    x = np.maximum(1.0 + g * g - 2.0 * g * cosine, 1e-4)
    norm = 3.0 * (1.0 - g * g) / (8.0 * np.pi * (2.0 + g * g))
    return np.asarray(norm * (1.0 + cosine * cosine) / (x * np.sqrt(x)))
