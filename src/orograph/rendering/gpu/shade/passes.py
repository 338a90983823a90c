"""The passes of a frame: patches into depth and marks, light and colour per pixel, resolving to the display.

Shading is deferred: patches leave only depth and a word of marks per pixel, so that light is computed once per pixel
whatever is hidden, and one shader does all of it (``shaders/shade.wgsl``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import KEEP, Attachments, begin_compute, write
from orograph.rendering.gpu.shade.ray_field import RayBindings
from orograph.rendering.gpu.shade.ssao import Ssao
from orograph.rendering.gpu.shade.tracing import TRACED
from orograph.rendering.gpu.targets import DEPTH, EMPTY, LIGHT, Targets

FRAGMENTS, COMPUTED = ("fragment", "background"), ("compute",)
"""Entry points of the shading shader that make a picture."""

_WEIGHED = {"src_factor": "constant", "dst_factor": "one-minus-constant", "operation": "add"}
MEAN: list[dict[str, Any]] = [{"format": LIGHT, "blend": {"color": _WEIGHED, "alpha": _WEIGHED}}]
"""The target of light that has a weight in the mean."""

Part = tuple[int, int, int, int]
"""A rectangle of a target: x, y, width and height."""


class ShadePass:
    """Light and colour of every pixel, from depth and marks, added to what the target holds or replacing it.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
        missing: offset that marks missing heights (``tiles.missing``), metres.
    """

    def __init__(self, device: Device, camera: Any, missing: int) -> None:
        self.device, self.camera, self.missing = device, camera, missing
        self._computes = device.computes
        self.shown = COMPUTED if self._computes else FRAGMENTS
        program = self._program(TRACED)
        self._looked_up = program.groups[1]
        self.rays = RayBindings(device, program.groups[2])
        self._mean = Program(device, "light_mean")
        self._blend: Any = None
        self._newest: tuple[Any, Any] = (None, None)
        self._part = device.buffer(16, "UNIFORM", "part of the light")
        self._outs: list[tuple[Any, bool, Any]] = []
        self._pipelines: dict[tuple[int, str], Any] = {}
        self._bound: tuple[list[Any], Any] = ([], None)
        self._compiler = BackgroundTask()
        self._last: int | None = None
        self.camera_group = program.bind({"camera": camera})
        # (Footprints are filtered along their major axis by the shader, as on the CPU: an atlas has no derivatives.)
        self.sampler = device.handle.create_sampler(
            mag_filter="linear", min_filter="linear", mipmap_filter="linear", max_anisotropy=1
        )

    def group(self, targets: Targets, resources: dict[str, Any]) -> Any:
        """The bind group of what a frame looks up: buffers and texture views by the names of ``shade.wgsl``; the
        targets' own and the sampler are added.

        It is reused while the objects are the same: making one takes longer than a frame's other calls.
        """
        asked = [targets.depth_view, targets.marks_view, *resources.values()]
        if len(asked) == len(self._bound[0]) and all(a is b for a, b in zip(asked, self._bound[0], strict=True)):
            return self._bound[1]
        here = {"depths": targets.depth_view, "marks": targets.marks_view, "atlas_sampler": self.sampler}
        group = self._looked_up.bind({**here, **resources})
        self._bound = asked, group
        return group

    def available(self, flags: int, also: Callable[[], Any], *, wait: bool) -> int:
        """The flags to draw with: the wanted ones, or the last ones while a thread compiles the wanted ones.

        Compiling takes a hundred milliseconds or more, which only the first frame can afford.

        Args:
            also: compiles whatever else a frame with these flags needs.
            wait: compile at once.
        """
        self._compiler.take()
        there = all((flags, entry) in self._pipelines for entry in self.shown)
        if wait or there or self._last is None or self._compiler.done == flags:
            self._last = flags
        elif self._compiler.wants(flags):
            self._compiler.start(flags, lambda: (also(), *(self.pipeline(flags, entry) for entry in self.shown)))
        return self._last

    @property
    def busy(self) -> bool:
        """Whether something is compiling, so that a later frame will look different."""
        return self._compiler.busy

    def pipeline(self, flags: int, entry: str = "fragment") -> Any:
        """The pipeline for what is drawn (``look``'s flags), compiled on first use.

        ``entry``: "fragment" (ground, where there is depth) or "background" (where there is none), which give light its
        weight in the target's mean; "compute", both; or "surface" (depth and normals).
        """
        found = self._pipelines.get((flags, entry))
        if found is None:
            program = self._program(flags)
            if entry in COMPUTED:
                found = program.compute(entry)
            elif entry == "surface":
                found = program.draw([{"format": "r32float"}, {"format": LIGHT}], fragment=entry)
            else:
                found = program.draw(MEAN, fragment=entry, depth={
                    "format": DEPTH, "depth_write_enabled": False,
                    "depth_compare": "less" if entry == "fragment" else "greater-equal",  # than the triangle's 0
                })  # fmt: skip
            self._pipelines[flags, entry] = found
        return found

    def _program(self, flags: int) -> Program:
        by_rays = int(bool(flags & TRACED))
        return Program(
            self.device, "shade", FLAGS=flags, RAYS=by_rays, RAY_GROUP=2, OUT_GROUP=2 + by_rays,
            COMPUTED=int(self._computes), MISSING=self.missing,
        )  # fmt: skip

    def draw(
        self, encoder: Any, targets: Targets, group: Any, flags: int, *, frame: int = 0, clear: bool = True,
        part: Part | None = None,
    ) -> None:  # fmt: skip
        """Add the light of all pixels to the target, which holds the mean over ``frame`` earlier frames.

        The depth test separates ground from background, so that no pixel is shaded twice.

        Args:
            clear: whether a first frame clears the target. part: None: all.
        """
        if self._computes:
            self._compute(encoder, targets, group, flags, frame, part or (0, 0, targets.width, targets.height))
            return
        before = EMPTY if frame == 0 and clear else None
        pass_ = targets.attached(
            "light" if before else "more light",
            lambda: Attachments([(targets.light_view, before)], (targets.depth_view, KEEP)),
        ).begin(encoder)
        self.set_groups(pass_, targets.light_view, group, flags)
        if part is not None:
            pass_.set_scissor_rect(*part)
        pass_.set_blend_constant((1.0 / (frame + 1),) * 4)
        for entry in self.shown:
            pass_.set_pipeline(self.pipeline(flags, entry))
            pass_.draw(3)
        pass_.end()

    def set_groups(self, pass_: Any, onto: Any, group: Any, flags: int) -> None:
        """Set the groups of a pass. Args: onto: the view that computed light goes to."""
        traced = bool(flags & TRACED)
        groups = [self.camera_group, group, *([self.rays.group] if traced else [])]
        if self._computes:
            known = next((out for view, with_rays, out in self._outs if view is onto and with_rays == traced), None)
            if known is None:
                known = self._program(flags).bind({"part": self._part, "computed": onto}, len(groups))
                self._outs = [(onto, traced, known), *self._outs[:3]]
            groups.append(known)
        for k, bound in enumerate(groups):
            pass_.set_bind_group(k, bound)

    def _compute(self, encoder: Any, targets: Targets, group: Any, flags: int, frame: int, part: Part) -> None:
        """Like ``draw``: a first frame's light is written to the target, that of others to a texture, then blended."""
        view = targets.newest_view(self.device) if frame else targets.light_view
        write(self.device, self._part, np.array(part, np.uint32))
        pass_ = begin_compute(encoder)
        pass_.set_pipeline(self.pipeline(flags, *COMPUTED))
        self.set_groups(pass_, view, group, flags)
        pass_.dispatch_workgroups(-(-part[2] // 8), -(-part[3] // 8))
        pass_.end()
        if not frame:
            return
        if self._blend is None:
            self._blend = self._mean.draw(MEAN)
        blend = targets.attached("blended light", lambda: Attachments([(targets.light_view, None)])).begin(encoder)
        blend.set_pipeline(self._blend)
        if self._newest[0] is not view:
            self._newest = view, self._mean.bind({"computed": view})
        blend.set_bind_group(0, self._newest[1])
        blend.set_scissor_rect(*part)
        blend.set_blend_constant((1.0 / (frame + 1),) * 4)
        blend.draw(3)
        blend.end()


class ScreenOcclusion:
    """Ambient occlusion in screen space of what the targets hold (``ssao``): depth and normals from the shading's data.

    Args:
        shading: looks up the ground's slope.
    """

    def __init__(self, device: Device, shading: ShadePass) -> None:
        self.device, self.shading = device, shading
        self._passes: Ssao | None = None
        self._surface: list[Any] = []

    def encode(self, encoder: Any, targets: Targets, group: Any, pixel: float, radius: float, perspective: bool) -> Any:
        """Add the passes; returns the view of a texture of each pixel's openness.

        Args:
            pixel: metres of a pixel at depth 1, or anywhere in a plan. radius: metres.
        """
        size = targets.width, targets.height
        if not self._surface or tuple(self._surface[0].size[:2]) != size:
            usage = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            self._surface = [self.device.texture(size, kind, usage, label="surface") for kind in ("r32float", LIGHT)]
        views = [texture.create_view() for texture in self._surface]
        pass_ = encoder.begin_render_pass(
            color_attachments=[
                {"view": view, "clear_value": (0, 0, 0, 0), "load_op": "clear", "store_op": "store"} for view in views
            ]
        )
        pass_.set_pipeline(self.shading.pipeline(0, "surface"))
        self.shading.set_groups(pass_, targets.light_view, group, 0)
        pass_.draw(3)
        pass_.end()
        if self._passes is None:
            self._passes = Ssao(self.device)
        made = self._passes.encode(
            encoder, self._surface[0], self._surface[1], size, (pixel, pixel), radius, perspective=perspective
        )
        return made.create_view()


class ResolvePass:
    """The mean over a pixel's samples and over accumulated frames, encoded for the display."""

    def __init__(self, device: Device, format: str) -> None:
        self.device = device
        self.encode = 0 if format.endswith("-srgb") else 1
        self.uniform = device.buffer(16, "UNIFORM", "resolve")
        self._written = b""
        self._bound: list[tuple[Any, Any, Any]] = []
        self._onto: tuple[Any, Attachments] | None = None
        self._program = Program(device, "resolve")
        self.pipeline = self._program.draw([{"format": format}])

    def draw(
        self, encoder: Any, targets: Targets, view: Any, *, frames: int = 1, occlusion: Any = None,
        strength: float = 0.0, light: Any = None,
    ) -> None:  # fmt: skip
        """Write the light to a view.

        Args:
            frames: the number of frames summed in the light.
            occlusion: a texture's view to multiply it by, with ``strength``.
            light: a view of it, if it is not the targets' light.
        """
        values = np.zeros(4, np.uint32)
        values[2] = self.encode
        values[1:2].view(np.float32)[0] = frames
        values[3:4].view(np.float32)[0] = strength if occlusion is not None else 0.0
        if values.tobytes() != self._written:
            write(self.device, self.uniform, values)
            self._written = values.tobytes()
        light = targets.light_view if light is None else light
        group = next((g for bright, dark, g in self._bound if bright is light and dark is occlusion), None)
        if group is None:
            dark = light if occlusion is None else occlusion
            group = self._program.bind({"resolve": self.uniform, "light": light, "open": dark})
            self._bound = [(light, occlusion, group), *self._bound[:2]]  # (frames take turns with two)
        if self._onto is None or self._onto[0] is not view:
            self._onto = view, Attachments([(view, (0.0, 0.0, 0.0, 1.0))])
        pass_ = self._onto[1].begin(encoder)
        pass_.set_pipeline(self.pipeline)
        pass_.set_bind_group(0, group)
        pass_.draw(3)
        pass_.end()
