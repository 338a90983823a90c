"""Screen-space ambient occlusion of a picture: depth and normals in, occlusion out, for viewers.

Jimenez, Wu, Pesce & Jarabo 2016 ("GTAO"): per pixel, horizons are searched for along lines of the depth buffer and the
visible arc is integrated in closed form; then a blur that keeps to one surface. The radius is in metres, so occlusion
stays on the ground when the camera moves. It only uses what the picture shows: ground that is hidden, beyond the
picture's border or smaller than a pixel does not occlude, and the search skips pixels (``steps`` per side). The ambient
occlusion of the ground itself is baked or computed by ``orograph.lighting``; this is for moving or unbaked things.

``Ssao`` works on a renderer's textures, ``screen_occlusion`` on arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Program

Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Quality:
    """Extent of the search.

    Attributes:
        slices: planes through the view vector. steps: pixels examined on each side of a slice.
        falloff: share of the radius over which occluders fade out, in [0, 1].
        most: pixels that the radius is clamped to, near the eye.
        blur: whether to even out the noise between pixels.
    """

    slices: int = 4
    steps: int = 12
    falloff: float = 0.25
    most: float = 256.0
    blur: bool = True


class Ssao:
    """The passes on a device. Textures are recreated when the size changes.

    Args:
        device: holds the depth and the normals.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._program = Program(device, "ssao")
        self._main, self._blur = self._program.compute("main"), self._program.compute("blur")
        self._frame = device.buffer(48, "UNIFORM")
        self._textures: list[Any] = []

    def encode(
        self,
        encoder: Any,
        depth: Any,
        normals: Any,
        size: tuple[int, int],
        slope: tuple[float, float],
        radius: float,
        *,
        perspective: bool = True,
        quality: Quality | None = None,
        seed: int = 0,
    ) -> Any:
        """Add the passes to a command encoder.

        Args:
            depth: texture or view of one float channel (r32float): metres along the view axis; ≤ 0: sky.
            normals: texture or view of unit normals in view space (right, up, into the picture), any float format.
            size: (width, height), pixels.
            slope: metres right and up per pixel, at depth 1 (perspective) or at any (orthographic).
            radius: R, metres.
            seed: rotates the noise from frame to frame.

        Returns:
            a texture (r32float) of the occlusion, 1 where nothing occludes; valid until the next call.
        """
        how = quality or Quality()
        if not radius > 0 or how.slices < 1 or how.steps < 1 or not 0 <= how.falloff <= 1:
            raise UsageError("Screen-space occlusion needs a positive radius, a slice, a step and a falloff in [0, 1].")
        if not self._textures or self._textures[0].size[:2] != size:
            usage = "STORAGE_BINDING|TEXTURE_BINDING|COPY_SRC"
            self._textures = [self.device.texture(size, "r32float", usage, label="ssao") for _ in range(2)]
        frame = np.zeros(12, np.float32)
        frame[:6] = *size, *slope, radius, how.falloff
        frame[6:8] = np.array([how.slices, how.steps], np.uint32).view(np.float32)
        frame[8:12] = float(perspective), how.most, 0.5, seed
        self.device.queue.write_buffer(self._frame, 0, frame)
        raw, smooth = self._textures
        passes = [(self._main, smooth, raw)] + ([(self._blur, raw, smooth)] if how.blur else [])
        for pipeline, source, target in passes:
            work = encoder.begin_compute_pass()
            work.set_pipeline(pipeline)
            group = {"frame": self._frame, "depth": depth, "normals": normals, "occlusion": source, "out": target}
            work.set_bind_group(0, self._program.bind(group))
            work.dispatch_workgroups(-(-size[0] // 8), -(-size[1] // 8))
            work.end()
        return passes[-1][2]


def screen_occlusion(
    depth: ArrayLike,
    normals: ArrayLike,
    slope: float | tuple[float, float],
    radius: float,
    *,
    perspective: bool = True,
    quality: Quality | None = None,
    device: Device | None = None,
) -> Values:
    """Screen-space occlusion of a depth buffer in memory.

    Args:
        depth: (height, width), metres along the view axis; ≤ 0, NaN or inf: sky.
        normals: (height, width, 3) unit normals in view space: right, up, into the picture.
        slope: as for ``Ssao.encode``; for a ``View`` it is ``view.pixel_slope``.
        radius: R, metres.

    Returns:
        (height, width) float32 in [0, 1], 1 also for the sky.

    Raises:
        UsageError: wrong shapes or parameters. NoAdapterError: there is no GPU.
    """
    z = np.array(depth, np.float32)
    z[~np.isfinite(z)] = 0.0
    facing = np.nan_to_num(np.asarray(normals, np.float32))
    if z.ndim != 2 or facing.shape != (*z.shape, 3):
        raise UsageError(
            f"Depth must be (height, width) and normals (height, width, 3), not {z.shape} and {facing.shape}."
        )
    gpu = device or open_device()
    height, width = z.shape
    textures = []
    for values, kind in ((z[..., None], "r32float"), (np.pad(facing, [(0, 0), (0, 0), (0, 1)]), "rgba32float")):
        texture = gpu.texture((width, height), kind, "TEXTURE_BINDING|COPY_DST")
        row = {"bytes_per_row": values.shape[2] * 4 * width, "rows_per_image": height}
        gpu.queue.write_texture({"texture": texture}, np.ascontiguousarray(values), row, (width, height, 1))
        textures.append(texture)
    both = (slope, slope) if isinstance(slope, int | float) else slope
    encoder = gpu.handle.create_command_encoder()
    made = Ssao(gpu).encode(
        encoder, textures[0], textures[1], (width, height), both, radius, perspective=perspective, quality=quality
    )
    gpu.queue.submit([encoder.finish()])
    return gpu.read_texture(made, np.float32, 1)[..., 0].copy()
