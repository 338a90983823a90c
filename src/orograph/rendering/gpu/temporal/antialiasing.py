"""Temporal antialiasing: frames accumulate samples while the camera moves, as a picture at rest does.

Every frame moves the samples within its pixels (a Halton sequence). The place in the last frame of the ground that a
pixel shows follows from its depth and the two cameras. The mean gathered there continues; the new frame is one of many
in it, with a weight of at least ``SHARE`` (temporal supersampling: Yang et al. 2009, *Amortized supersampling*; Karis
2014 for the cubic). What moves fast or changes its scale has a greater weight, because every look-up blurs. Depth
tells whether a mean is of the same ground: ground at a depth that no nearby pixel had in the last frame was hidden.
Only then, on ground with new tiles, and where light has changed, is the mean clamped to the range of the 3 × 3 pixels
around, so that it leaves no ghost. If it was always clamped, the mean of a horizon with more detail than pixels would
follow every sample. Where tiles arrived it starts again. At rest the mean of a pixel's own samples gradually takes
over. Linear light; depths in metres; areas of the ground in sample coordinates.
"""

from __future__ import annotations

from dataclasses import fields
from operator import attrgetter
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import Attachments, begin_compute, write
from orograph.rendering.gpu.camera import axes_of
from orograph.rendering.gpu.targets import EMPTY, LIGHT, Targets
from orograph.scene.scene import Scene

SHARE = 1 / 48
"""Minimum weight of a new frame in the mean of many: an edge between ground and sky must not flicker by more."""

FAR = "r32float"
"""The format of the depths that a frame keeps for the next one."""

FULL = 16
"""Samples of a pixel at rest after which no more are needed."""

AREAS = 64
"""The most areas of ground with new tiles; beyond that the whole picture counts as new."""

Areas = NDArray[np.floating]
NONE: Areas = np.empty((0, 4))
_ZEROS = (0.0,) * (4 * AREAS)
_UNIFORM = Struct(f"<20f4I{4 * AREAS}f")
OWN = "view", "depths", "terrain", "furniture", "title"
"""Parts of a scene that may change between the frames of one picture."""
_settings = attrgetter(*(f.name for f in fields(Scene) if f.name not in OWN))


def _halton(k: int, base: int) -> float:
    value, part = 0.0, 1.0
    while k:
        part /= base
        k, digit = divmod(k, base)
        value += part * digit
    return value


SHIFTS = tuple((_halton(k, 2) - 0.5, _halton(k, 3) - 0.5) for k in range(1, FULL + 1))
"""The sample position of each frame, pixels from the pixel's middle."""


class TemporalAntialiasing:
    """The mean of a moving picture.

    Args:
        camera: the uniform buffer of the frame that was drawn.
    """

    def __init__(self, device: Device, camera: Any) -> None:
        self.device = device
        computes = device.computes
        self._program = Program(device, "temporal_antialiasing", COMPUTED=int(computes))
        self._pipeline = (
            self._program.compute("compute") if computes else self._program.draw([{"format": LIGHT}, {"format": FAR}])
        )
        self._camera = self._program.bind({"camera": camera})
        self._sampler = device.handle.create_sampler(mag_filter="linear", min_filter="linear")
        self._uniform = device.buffer(_UNIFORM.size, "UNIFORM", "temporal antialiasing")
        self._targets: Targets | None = None
        self._views: list[Any] = []
        self._far: list[Any] = []
        self._onto: list[Attachments] = []
        self._groups: list[Any] = []
        self._turn = self._tick = 0
        self._last: tuple[tuple[float, ...], Scene, Any] | None = None
        self._made: tuple[Any, ...] = ()

    @property
    def shift(self) -> tuple[float, float]:
        """The sample position of the next frame."""
        return SHIFTS[self._tick % FULL] if self._last is not None else (0.0, 0.0)

    def forget(self) -> None:
        """Start a new picture with the next frame."""
        self._last = None

    def encode(
        self, encoder: Any, targets: Targets, scene: Scene, settings: Any, shift: tuple[float, float], gathered: int,
        came: Areas = NONE, made: tuple[Any, ...] = (),
    ) -> Any:  # fmt: skip
        """Add the pass that takes a frame into the mean; return the view of the mean's texture.

        Args:
            targets: the frame's.
            settings: whatever makes it another picture besides the scene.
            shift: the position in their pixels of the samples whose depths the targets hold.
            gathered: the number of samples of the same place that the light averages.
            came: (n, 4) west, north, east, south of the ground whose tiles arrived for this frame, sample coordinates.
            made: background results for the ground and its light, identified by their ids.
        """
        if targets is not self._targets:
            self._fit(targets)
        same = self._last is not None and settings == self._last[2] and _alike(scene, self._last[1])
        fresh = len(came) > AREAS or [id(thing) for thing in made] != [id(thing) for thing in self._made]
        self._made = made  # (kept alive, so that their ids stay unique)
        self._write(scene, shift, gathered, same, fresh, came)
        self._turn = 1 - self._turn
        self._tick += 1
        computes = self.device.computes
        pass_ = begin_compute(encoder) if computes else self._onto[self._turn].begin(encoder)
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, self._camera)
        pass_.set_bind_group(1, self._groups[self._turn])
        if computes:
            pass_.dispatch_workgroups(-(-targets.width // 8), -(-targets.height // 8))
        else:
            pass_.draw(3)
        pass_.end()
        right, up, forward, centre = axes_of(scene.view, scene.surface.exaggeration)
        self._last = (*right, *up, *forward, *centre), scene, settings
        return self._views[self._turn]

    def _write(
        self, scene: Scene, shift: tuple[float, float], gathered: int, same: bool, fresh: bool, came: Areas
    ) -> None:  # fmt: skip
        packed = bytes(_UNIFORM.size)
        if same and self._last is not None:
            camera, before, _ = self._last
            (a, b, c), (p, q, r) = _eye(scene), _eye(before)
            share = SHARE if gathered <= 1 else min(1.0, gathered / FULL)
            known = 2.0 if fresh else 1.0
            areas = [] if fresh or not len(came) else _from_eye(came, scene).tolist()
            packed = _UNIFORM.pack(
                *camera[:11], known, a - p, b - q, (c - r) * scene.surface.exaggeration, share, *camera[11:], *shift,
                len(areas) // 4, 0, 0, 0, *areas, *_ZEROS[len(areas) :],
            )  # fmt: skip
        write(self.device, self._uniform, packed)

    def _fit(self, targets: Targets) -> None:
        self._targets, self._last = targets, None
        size = targets.width, targets.height
        computes = self.device.computes
        usage = f"{'STORAGE_BINDING' if computes else 'RENDER_ATTACHMENT'}|TEXTURE_BINDING"
        self._views, self._far = (
            [self.device.texture(size, kind, usage, label="temporal antialiasing").create_view() for _ in range(2)]
            for kind in (LIGHT, FAR)
        )
        pairs = list(zip(self._views, self._far, strict=True))
        self._onto = [] if computes else [Attachments([(view, EMPTY) for view in pair]) for pair in pairs]
        self._groups = [
            self._program.bind(
                {
                    "temporal": self._uniform, "light": targets.light_view, "depth": targets.depth_view,
                    "before": self._views[1 - turn], "smooth_": self._sampler, "far_before": self._far[1 - turn],
                    **(dict(zip(("onto", "far_onto"), pairs[turn], strict=True)) if computes else {}),
                },
                1,
            )
            for turn in range(2)
        ]  # fmt: skip


def _eye(scene: Scene) -> tuple[float, float, float]:
    view = scene.view
    return (*view.target[:2], view.eye[2]) if view.projection == "plan" else view.eye


def _from_eye(areas: Areas, scene: Scene) -> Areas:
    """Areas in one row (4 n,), columns and rows counted from the eye's."""
    x, y, _ = _eye(scene)
    col, row = (float(v) for v in scene.terrain.grid.index(x, y))
    return np.asarray(areas - np.array([col, row, col, row]), np.float32).ravel()


def _alike(one: Scene, other: Scene) -> bool:
    """Whether two scenes differ only in the camera."""
    if one is other:
        return True
    if one.view.projection != other.view.projection:
        return False
    return bool(_settings(one) == _settings(other))
