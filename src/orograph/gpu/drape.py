"""A draped image on the GPU: its pyramid in a texture with mip levels, its lattice of positions in a buffer.

The pyramid is that of the CPU (``geovis.mipmap``), put into a texture whose sides are multiples of the coarsest texel,
so that each level's texels are where they were; the sampler blends within and between levels. Colours are multiplied by
opacity, as blending wants them. Positions are interpolated in the lattice (``geovis.placement``) as on the CPU. An
image larger than the device's largest texture begins at the first level that fits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.drape import Drape
from orograph.geovis.mipmap import curves
from orograph.gpu.device import Device
from orograph.view import View


class DrapeTexture:
    """An image, uploaded.

    Attributes:
        view: of the texture. lattice: the storage buffer of ``shaders/drape.wgsl``.
        warnings: what a user should know.
    """

    def __init__(self, device: Device, drape: Drape) -> None:
        self.device, self.drape = device, drape
        self.warnings = list(drape.warnings)
        most = min(int(device.handle.limits["max-texture-dimension-2d"]), 16384)
        levels = drape.levels()
        first = 0
        while max(levels[first].shape[:2]) > most:
            first += 1
        if first:
            self.warnings.append(
                f"{drape.path} is drawn {1 << first} times coarser: the GPU takes {most} texels a side."
            )
        levels = levels[first:]
        rows, cols = levels[0].shape[:2]
        count = 1
        while count < len(levels) and max(_padded(rows, count + 1), _padded(cols, count + 1)) <= most:
            count += 1
        size = _padded(cols, count), _padded(rows, count)
        texture = device.texture(size, "rgba8unorm-srgb", "TEXTURE_BINDING|COPY_DST", label="drape", levels=count)
        for k, level in enumerate(levels[:count]):
            wide, high = size[0] >> k, size[1] >> k
            block = np.pad(_multiplied(level), ((0, high - level.shape[0]), (0, wide - level.shape[1]), (0, 0)), "edge")
            device.queue.write_texture(
                {"texture": texture, "mip_level": k}, np.ascontiguousarray(block),
                {"bytes_per_row": 4 * wide, "rows_per_image": high}, (wide, high, 1),
            )  # fmt: skip
        self.view = texture.create_view()
        lattice, window = drape.lattice, drape.window
        scale = float(window.step << first)
        u, v = (lattice.u - window.col0) / scale, (lattice.v - window.row0) / scale
        density = np.pad(lattice.density(), ((0, 1), (0, 1)), "edge") / scale
        there = np.isfinite(u) & np.isfinite(v)
        nodes = np.stack([np.nan_to_num(u), np.nan_to_num(v), density, there], -1)
        self._head = np.zeros((3, 4), np.float32)
        self._head[0] = u.shape[1], u.shape[0], cols, rows
        self.lattice = device.buffer(
            np.concatenate([self._head, nodes.reshape(-1, 4).astype(np.float32)]), "STORAGE", "drape lattice"
        )

    def aim(self, view: View) -> None:
        """Tell the shader where the eye is: positions are metres from it."""
        a, b, c, d, e, f = self.drape.lattice.index[:6]
        x, y = view.target[:2] if view.projection == "plan" else view.eye[:2]
        self._head[1, :3] = a, b, a * x + b * y + c
        self._head[2, :3] = d, e, d * x + e * y + f
        self.device.queue.write_buffer(self.lattice, 0, self._head)


def _padded(size: int, levels: int) -> int:
    """The side of a texture in which ``levels`` halvings come out even."""
    grain = 1 << (levels - 1)
    return -(-size // grain) * grain


def _multiplied(level: NDArray[np.uint8]) -> NDArray[Any]:
    """sRGB colours multiplied (in linear light) by their opacity."""
    opacity = level[..., 3]
    if opacity.min() == 255:
        return level
    decode, encode = curves()
    out = level.copy()
    partial = opacity < 255
    linear = decode[level[partial][:, :3]] * (opacity[partial].astype(np.float32) / 255)[:, None]
    out[partial, :3] = encode[np.round(linear * 65535).astype(np.intp)]
    return out
