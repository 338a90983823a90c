"""Ambient aperture lighting on the GPU: the tables of ``shaders/aperture.wgsl``, and light on points.

The shading functions are the float32 twin of ``orograph.lighting.aperture_kernels`` (Oat & Sander 2007), for renderers
to include. ``light`` runs them on points of the ground, as ``orograph.lighting.aperture.light`` does on the CPU.

Float32 differs from the CPU's float64 by less than 1e-5 of the lights' sum on caps and discs of some degrees, and by
3e-5 on the rim of a cap in front of the true sun, whose whole penumbra is 0.009 radians wide (caps are stored as the
cosine of their radius, with a precision of 6e-8 in float32). A lamp exactly on a cap's rim may be visible in one and
not in the other. If a corner of the field is missing, the CPU uses the open sky; here, the other corners are mixed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Program
from orograph.lighting.aperture import CapField, Lights

Array = NDArray[np.float64]
Values = NDArray[np.float32]

SUN = np.dtype(
    [("direction", "f4", 3), ("radius", "f4"), ("color", "f4", 3), ("cosine", "f4"), ("sine", "f4"), ("area", "f4"),
     ("pad", "f4", 2)]
)  # fmt: skip
"""``Sun`` of the shader: direction east, north, up; radians; steradians."""

LAMP = np.dtype([("place", "f4", 3), ("pad", "f4"), ("color", "f4", 3), ("pad2", "f4")])
"""``Lamp`` of the shader: metres east, north and up from the origin."""

_POINT = np.dtype([("place", "f4", 3), ("col", "f4"), ("gradient", "f4", 2), ("row", "f4"), ("pad", "f4")])
_GROUP = 64
_WIDE = 32768  # groups along x


def tables(lights: Lights, linear: ArrayLike, origin: ArrayLike) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Suns and lamps in the form of the shader, at least one of each (one without light if there is none).

    Args:
        linear: (2, 2) metres east and north per column and per row.
        origin: (3,) metres east and north of sample (0, 0), and height: the origin of lamps' positions.
    """
    suns, lamps, _ = lights.tables(np.asarray(linear, np.float64))
    lit, hung = np.zeros(max(len(suns), 1), SUN), np.zeros(max(len(lamps), 1), LAMP)
    if len(suns):
        lit["direction"], lit["radius"], lit["color"] = suns[:, :3], suns[:, 3], suns[:, 7:10]
        lit["cosine"], lit["sine"], lit["area"] = suns[:, 4], suns[:, 5], suns[:, 6]
    if len(lamps):
        hung["place"], hung["color"] = lamps[:, :3] - np.asarray(origin, np.float64), lamps[:, 3:]
    return lit, hung


def packed(caps: Values) -> Values:
    """Caps (n, 4) as two words each (2n,) float32: east and up, north and the radius' cosine, in 16 bits each.

    The error is at most 1.6e-5. The component that is never negative is in the upper half, from 128 up, so that the
    words are neither denormal nor NaN as floats, which a driver may change.
    """
    out = np.empty((len(caps), 2), np.uint32)
    for k, (signed, positive) in enumerate(((0, 2), (1, 3))):
        low = np.rint(np.clip(caps[:, signed], -1, 1) * 32767).astype(np.int32) & 0xFFFF
        high = np.rint(np.clip(caps[:, positive], 0, 1) * 32384).astype(np.int32) + 128
        out[:, k] = (high << 16 | low).astype(np.uint32)
    return out.view(np.float32).ravel()


def light(
    caps: CapField, points: Array, gradient: Array, lights: Lights, *, exact: bool = False, device: Device | None = None
) -> Values:
    """Light on points of the ground through the caps of a field: ``orograph.lighting.aperture.light``, on the GPU.

    Raises:
        NoAdapterError: there is no GPU to do it.
    """
    gpu = device or open_device()
    cells, values = caps.linear, caps.values
    known = np.isfinite(points).all(axis=1)
    out = np.full((len(points), 3), np.nan, np.float32)
    if not known.any():
        return out
    where = np.column_stack([points[known, :2] @ cells.T, points[known, 2]])
    origin = where.mean(axis=0)
    rows = np.zeros(int(known.sum()), _POINT)
    rows["place"], rows["gradient"] = where - origin, gradient[known]
    rows["col"] = (points[known, 0] + 0.5) / caps.scale - 0.5 - caps.col0
    rows["row"] = (points[known, 1] + 0.5) / caps.scale - 0.5 - caps.row0
    suns, lamps = tables(lights, cells, origin)
    frame = np.zeros(12, np.uint32)
    frame[:4] = len(rows), len(lights.suns), len(lights.lamps), exact
    frame[4:6] = values.shape[1], values.shape[0]
    frame[8:11] = np.asarray(lights.ambient, np.float32).view(np.uint32)
    field = np.where(np.isfinite(values).all(axis=-1, keepdims=True), values, np.float32(0.0)).astype(np.float32)
    result = gpu.buffer(16 * len(rows), "STORAGE|COPY_SRC")
    program = Program(gpu, "aperture_light")
    stored = {"points": rows, "field": field, "suns": suns, "lamps": lamps}
    group = program.bind(
        {name: gpu.buffer(a, "STORAGE") for name, a in stored.items()}
        | {"frame": gpu.buffer(frame, "UNIFORM"), "lit": result}
    )
    encoder = gpu.handle.create_command_encoder()
    lighting = encoder.begin_compute_pass()
    lighting.set_pipeline(program.compute())
    lighting.set_bind_group(0, group)
    groups = -(-len(rows) // _GROUP)
    lighting.dispatch_workgroups(min(groups, _WIDE), -(-groups // _WIDE))
    lighting.end()
    gpu.queue.submit([encoder.finish()])
    out[known] = gpu.read_buffer(result, np.float32).reshape(-1, 4)[:, :3]
    return out
