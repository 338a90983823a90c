"""The terrain renderer: a scene becomes a frame, out of core, at the rate of the screen.

A frame: newly read tiles are uploaded to the atlases; ``triangle-patches`` selects patches whose tiles are present
(coarser ones stand in, so there are no holes, no cracks and no waiting); one instanced draw leaves depth and marks; one
pass lights every pixel. Tiles that the frame lacked are requested from the streamer, largest error first. Maps of light
follow the camera in their own thread. When nothing changes, further frames are drawn with jittered samples and
averaged: a picture at rest is smooth everywhere.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lod.selection import TriangleMesh
from orograph.memo import Memo
from orograph.rendering.gpu.camera import CAMERA, camera_of
from orograph.rendering.gpu.frame import PLAIN, FrameChoice, FrameStats, Overlay
from orograph.rendering.gpu.overview import Seen, overview
from orograph.rendering.gpu.reading import Reading
from orograph.rendering.gpu.shade.following import Following, maps_key
from orograph.rendering.gpu.shade.lettering import Letters
from orograph.rendering.gpu.shade.look import DRAPE, FIELD, LABELS, SILHOUETTES, SMOOTH, WIREFRAME
from orograph.rendering.gpu.shade.look_cache import SLOPES, Looks
from orograph.rendering.gpu.shade.outlines import BreakPass
from orograph.rendering.gpu.shade.passes import ResolvePass, ScreenOcclusion, ShadePass
from orograph.rendering.gpu.shade.resources import Resources
from orograph.rendering.gpu.shade.tracing import RAYS, TRACED, Around, Share, casts, parts_of
from orograph.rendering.gpu.stream.image_tiles import SIDE
from orograph.rendering.gpu.stream.imagery import Imagery
from orograph.rendering.gpu.stream.residency import Residency
from orograph.rendering.gpu.stream.tiles import missing
from orograph.rendering.gpu.surface.ground import Drawn, Ground
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.surface.resident import Resident
from orograph.rendering.gpu.surface.void_fill import VoidFillPass
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.gpu.temporal.antialiasing import NONE, TemporalAntialiasing
from orograph.rendering.gpu.temporal.jitter import SAMPLES, Jitter
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

ATLASES = 1 << 29
"""Default bytes of textures for tiles."""
LATE, PASSED = 0.008, 3
"""A frame that took longer than this, seconds, skips prefetching, as do the next frames up to this number."""


class Renderer(Reading):
    """Draws one terrain on one device.

    Args:
        device: where to draw.
        terrain: the terrain; it is read from several threads.
        gpu_memory: bytes of the atlases, a quarter of them for layers, if there are any; in addition half as many hold
            what rays of light meet, and a quarter the windows for ray casting, if used.
        memory: bytes of the method's tables.
        jobs: threads that read tiles.
    """

    def __init__(
        self,
        device: Device,
        terrain: Terrain,
        *,
        gpu_memory: int = ATLASES,
        memory: int = 1 << 30,
        jobs: int | None = None,
    ) -> None:
        self.device, self.terrain = device, terrain
        self.memo = Memo()
        self.tiles = Residency(device, terrain, 3 * (gpu_memory // 4), memory, jobs)
        self.imagery = Imagery(device, terrain, gpu_memory // 4, jobs)
        self.heights, self.slopes, self.method = self.tiles.heights, self.tiles.slopes, self.tiles.method
        self._camera = device.buffer(CAMERA.itemsize, "UNIFORM", "camera")
        self._resources = Resources(device, terrain, self.heights, self.slopes, self.imagery, self.memo)
        self._ground = Ground(
            device, terrain, self._camera, self.tiles, self._resources.stored_slopes, self._resources.levels,
            min(device.largest, gpu_memory // 4), jobs,
        )  # fmt: skip
        self._left = Left()
        self._letters = Letters(device, terrain)
        self._breaks = BreakPass(device, self._camera, terrain, self._resources.stored_slopes)
        self._void_fill = VoidFillPass(device, self._camera)
        self._shading = ShadePass(device, self._camera, missing(terrain))
        self._corners = ScreenOcclusion(device, self._shading)
        self._resolves: dict[str, ResolvePass] = {}
        self._targets: Targets | None = None
        self._light = Following(
            terrain, self.memo, self._void_fill, self.method.legs,
            upload=lambda pool: self._resources.upload("maps", pool),
        )  # fmt: skip
        self._looks = Looks(terrain, self.memo, self._light, self._void_fill)
        self._flags = 0
        self._samples = Jitter()
        self._antialiasing = TemporalAntialiasing(device, self._camera)
        self._around = Around(terrain, min(device.largest, gpu_memory // 2))
        self._missing = self._late = 0
        self._lit: Scene | None = None

    # ---- drawing ---------------------------------------------------------------------------------------------------

    def draw(
        self, target: Any, format: str, scene: Scene, *, overlay: Overlay = PLAIN, freeze: View | None = None,
        wait: bool = False, samples: int | None = None, advance: Callable[[float], None] = lambda part: None,
    ) -> FrameStats:  # fmt: skip
        """Draw a frame.

        Args:
            target: a texture view of the size of the scene's view; overwritten. format: its format.
            scene: the scene; its terrain must be the renderer's.
            overlay: shown in addition.
            freeze: the camera that patches are selected for, or a mesh refined, if not the scene's view (or, of a mesh,
                its ``mesh_view``).
            wait: first wait for all tiles and maps that the picture needs.
            samples: draw this many samples per pixel at once; None: one, and one more with every further frame at rest.
            advance: gets progress, part by part, when waiting for a ray-traced picture.

        Raises:
            OrographError: with ``wait``, a tile, a map or a mesh could not be made.
        """
        begun = time.perf_counter()
        view, chosen = scene.view, self._choose(scene, freeze, wait=wait)
        targets = self._fit(view.width, view.height)
        begin, count = self._samples.next((scene, overlay, freeze, *chosen.state, maps_key(scene)), samples, self.busy)
        self._light_for(scene, targets, chosen.ground, wait=wait)
        group, flags = self._shaded(scene, overlay, targets, chosen, wait=wait)
        if begin and flags != self._flags:  # compiled meanwhile: the accumulated samples look different
            begin, count = 0, 1
        self._flags, self._samples.gathered = flags, begin + count
        resolve = self._resolve(format)
        encoder = self.device.handle.create_command_encoder()
        # The first pass then covers all pixel centres, the others only depth edges (unless every pixel needs all
        # samples).
        adaptive = chosen.ground.at_breaks and (samples or 1) > 1
        adaptive = adaptive and not flags & (SILHOUETTES | RAYS) and not overlay.occlusion
        passes = count + adaptive
        for k in range(begin, begin + passes):
            shift = self._samples.place(k - adaptive, samples, (0.0, 0.0) if wait else self._antialiasing.shift)
            left = self._left._replace(edges=bool(flags & WIREFRAME), at_breaks=adaptive and k > 0)
            encoder = self._pass(
                encoder, targets, scene, chosen.ground, group, flags, shift, k, samples and passes, advance, left
            )  # fmt: skip
            if adaptive and k == 0:
                self._ground.find_breaks(encoder, targets, view.projection == "plan")
            if k + 1 < begin + passes:  # the camera is written before the next pass
                encoder = self._submitted(encoder)
        if adaptive:  # other readers see all pixels
            encoder = self._submitted(encoder)
            write(self.device, self._camera, camera_of(view, self.terrain, scene.surface.exaggeration))
            self._ground.draw(encoder, targets, chosen.ground, self._left)
            self._void_fill.draw(encoder, targets)
        dark = None
        if overlay.occlusion > 0 and overlay.reach != 0:
            plan = view.projection == "plan"
            dark = self._corners.encode(
                encoder, targets, group, view.pixel_metres if plan else view.pixel_slope,
                overlay.reach or view.distance / 12, not plan,
            )  # fmt: skip
        light = None
        if wait or samples is not None or flags & RAYS:
            self._antialiasing.forget()
        else:
            settings = overlay, freeze is None, chosen.layers, flags
            came = np.concatenate([self.tiles.areas, self.imagery.areas]) if chosen.loaded else NONE
            made, there = (self._light.maps, chosen.ground.other), self._samples
            light = self._antialiasing.encode(
                encoder, targets, scene, settings, there.shift, there.gathered, came, made
            )  # fmt: skip
        resolve.draw(encoder, targets, target, occlusion=dark, strength=overlay.occlusion, light=light)
        commands = encoder.finish()
        to_submit = time.perf_counter() - begun
        self.device.queue.submit([commands])
        after = 0.0 if wait else self._go_on(freeze or view, chosen.tolerance, scene.surface.exaggeration, to_submit)
        return self._stats(scene, chosen, to_submit, after)

    def overview(self, scene: Scene) -> Seen:
        """What a scene's whole view shows: all its tiles take their light and haze from it."""
        return self.memo(
            "overview", (scene.view.whole, scene.surface.exaggeration),
            lambda: overview(self.device, self._ground, self._camera, scene), self.terrain,
        )  # fmt: skip

    def prepare(self, format: str, scene: Scene, *, overlay: Overlay = PLAIN) -> None:
        """Do the one-time work of a scene's first frame in advance, so that it takes no longer than others.

        Loads kernels, compiles shaders and requests tiles; may be called in a thread, before any frame. Arguments as
        for ``draw``.
        """
        self._light.begin()
        look, slopes = self._looks.of(scene, overlay, exact=False), SLOPES[overlay.normals]
        flags = self._looks.features(look, bool(slopes))

        def compile() -> None:
            with contextlib.suppress(Exception):  # the frame reports what is wrong
                self._resolve(format)
                self._ground.compile(bool(flags & WIREFRAME), slopes)
                for entry in self._shading.shown:
                    self._shading.pipeline(flags, entry)

        beside = threading.Thread(target=compile, daemon=True)
        beside.start()
        self.tiles.choose(scene.view, scene.surface.tolerance or 1.0, scene.surface.exaggeration, wait=False)
        beside.join()

    @property
    def busy(self) -> bool:
        """Whether tiles or maps are still coming, so that the next frame will be better."""
        waiting = self._missing > 0 or self.tiles.waiting > 0 or self.imagery.waiting > 0
        parts = self._light, self._around, self._ground, self._letters, self._shading
        return waiting or any(part.busy for part in parts)

    @property
    def resting(self) -> bool:
        """Whether the picture is as good as it gets."""
        return not self.busy and self._samples.complete

    def close(self) -> None:
        """Stop reading."""
        self._ground.close()
        self.imagery.close()
        self._light.close()
        self._around.close()
        self._letters.close()

    # ---- parts of a frame ------------------------------------------------------------------------------------------

    def _choose(self, scene: Scene, freeze: View | None, *, wait: bool) -> FrameChoice:
        """What a frame draws: patches or a mesh, layers, letters."""
        view = scene.view
        if wait and view.part is not None:
            self.overview(scene)  # before choosing the tile's own ground, which it may replace
        tolerance = scene.surface.tolerance or 1.0
        if scene.annotations.contours is not None:
            tolerance *= scene.annotations.contours.finer(self.terrain, view, self.memo)
        ground = self._ground.choose(scene, freeze, tolerance, wait=wait)
        tiles, mesh = ground.streamed, ground.mesh
        layers = self.imagery.prepare(scene.data.layers, view, scene.surface.exaggeration, wait=wait)
        self._missing = tiles.missing + self.imagery.missing + self._ground.growing.lacking
        loaded = len(self.tiles.came) + self.imagery.loaded
        lettered = self._letters.prepare(scene, self._looks.contours(scene), wait=wait, mesh=mesh)
        state = loaded, layers, len(ground.patches.instances), ground.state, self._letters.state
        size = self.tiles.bytes + 4 * SIDE**2 * self.imagery.loaded + self._ground.growing.came
        return FrameChoice(ground, tolerance, layers, bool(lettered), loaded, size, state)

    def _shaded(
        self, scene: Scene, overlay: Overlay, targets: Targets, chosen: FrameChoice, *, wait: bool
    ) -> tuple[Any, int]:  # fmt: skip
        """Upload what the shading looks up: returns its bind group, and the flags of the shader."""
        view, maps, mesh, resident = scene.view, self._light.maps, chosen.ground.mesh, chosen.ground.resident
        assert maps is not None
        slopes = SLOPES[overlay.normals]
        given = bool(slopes)
        coarse = mesh is not None or resident is not None
        field = coarse and scene.annotations.contours is not None  # lines are the terrain's
        if wait:
            if resident is not None and overlay.normals == "faces" and casts(scene):
                mesh = resident.tessellation()
            self._around.at_once(scene, mesh if overlay.normals == "faces" else None)
        else:
            self._around.aside(scene)
        self._shading.rays.load(self._around.field)
        look = self._looks.of(scene, overlay, exact=wait)
        self.tint = look.tint
        u = look.uniform
        if view.part is not None:
            u = u.copy()
            u["corner"] = view.part[0] | view.part[1] << 16
        self._resources.shade_with(u)
        breaks: tuple[Any, Any] = None, None
        if int(u["flags"]) & SILHOUETTES:
            near, far, *_ = u["edge_range"]
            self._breaks.aim(
                (float(near), float(far)),
                scene.annotations.silhouettes.creases if scene.annotations.silhouettes else 0.0,
            )
            breaks = self._breaks.views(targets)
        views = self._letters.view, *breaks
        bound = self._resources.bound(look, maps, scene, targets, given=given or field, field=field, marks=views)
        group = self._shading.group(targets, bound)
        flags = self._looks.features(look, given)
        flags |= (LABELS if chosen.lettered else 0) | (DRAPE if chosen.layers else 0)
        flags |= (FIELD if field else 0) | (SMOOTH if self._looks.beyond_samples(scene) else 0)
        edges = bool(flags & WIREFRAME)
        self._left = Left(slopes=slopes, field=field)
        return group, self._shading.available(flags, lambda: self._ground.compile(edges, slopes), wait=wait)

    def _go_on(self, view: View, tolerance: float, exaggeration: float, taken: float) -> float:
        """Have threads read tiles, also prefetching if there is time, and make maps; returns the seconds that took."""
        begun = time.perf_counter()
        late = taken > LATE and self._late < PASSED
        self._late = self._late + 1 if late else 0
        self.tiles.prepare(view, tolerance, exaggeration, ahead=not late)
        self._light.go_on()
        return time.perf_counter() - begun

    def _stats(self, scene: Scene, chosen: FrameChoice, to_submit: float, after: float) -> FrameStats:
        """Statistics of a frame: seconds of Python until it was submitted, and after that."""
        patches, rays = chosen.ground.patches, chosen.ground.rays
        there, bound = chosen.ground.drawn, patches.stats["pixels"]
        triangles = there * self.method.legs**2
        if isinstance(chosen.ground.selection, TriangleMesh):
            triangles, bound = len(chosen.ground.selection.mesh.triangles), chosen.ground.selection.bound
        elif rays is not None:
            bound = max(rays.bound, bound) if there else rays.bound
        elif isinstance(chosen.ground.resident, Resident):
            triangles, bound = chosen.ground.resident.triangles, chosen.ground.resident.bound
        elif chosen.ground.resident is not None:
            counts, bound = self._ground.growing.counts, chosen.ground.resident.reached
            triangles = patches.stats["triangles"] if counts is None else counts.triangles
        return FrameStats(
            there, triangles, bound,
            chosen.ground.streamed.seconds * 1e3, (to_submit + after) * 1e3, chosen.loaded, chosen.bytes,
            self.tiles.count + self.imagery.count, self._missing,
            self._samples.gathered, failed=self._ground.failure or self.imagery.failure,
            current=self._ground.current(scene), notes=tuple(self.imagery.take_warnings()),
            submit_ms=to_submit * 1e3, making=self.imagery.making,
            windows=0 if rays is None or not len(patches.instances) else len(rays.windows),
        )  # fmt: skip

    def _submitted(self, encoder: Any) -> Any:
        """Submit an encoder; returns another one."""
        self.device.queue.submit([encoder.finish()])
        return self.device.handle.create_command_encoder()

    def _pass(
        self, encoder: Any, targets: Targets, scene: Scene, ground: Drawn, group: Any, flags: int,
        shift: tuple[float, float], k: int, samples: int | None, advance: Callable[[float], None], left: Left,
    ) -> Any:  # fmt: skip
        """Add a pass to the mean of the ``k`` before it; returns the encoder to continue with."""
        camera = camera_of(scene.view, self.terrain, scene.surface.exaggeration, shift=shift)
        write(self.device, self._camera, camera)
        self._ground.draw(encoder, targets, ground, left)
        self._void_fill.draw(encoder, targets)
        if flags & SILHOUETTES:
            self._breaks.draw(encoder, targets)
        self._samples.enough = SAMPLES
        if not flags & TRACED:
            self._shading.draw(encoder, targets, group, flags, frame=k)
            return encoder
        share = Share.of(self.device, scene, k, SAMPLES, samples=samples, shift=shift)
        self._samples.enough = share.frames
        self._shading.rays.run(share)
        parts = parts_of(self.device, (targets.width, targets.height), share.rays * share.lights)
        for n, part in enumerate(parts):
            self._shading.draw(encoder, targets, group, flags, frame=k, clear=n == 0, part=part)
            if n + 1 < len(parts):
                encoder = self._submitted(encoder)
                if samples is not None:
                    self.device.wait()  # so that Ctrl-C is handled in between
                    advance(1 / (len(parts) * samples))
        return encoder

    def _resolve(self, format: str) -> ResolvePass:
        if format not in self._resolves:
            self._resolves[format] = ResolvePass(self.device, format)
        return self._resolves[format]

    def _fit(self, width: int, height: int) -> Targets:
        if self._targets is None or (self._targets.width, self._targets.height) != (width, height):
            self._targets = Targets(self.device, width, height)
            self._samples.state = None
        return self._targets

    def _light_for(
        self, scene: Scene, targets: Targets, ground: Drawn, *, wait: bool
    ) -> None:  # fmt: skip
        """Provide maps of light for the scene: at once if ``wait``, else in the background while old ones are used."""
        if wait and scene.view.part is not None:
            whole = scene.but(view=scene.view.whole, samples=1)
            if self._lit != whole:
                self._light.at_once(whole, lambda: self.overview(scene))
                self._lit = whole
            return
        self._lit = None
        if not wait:
            self._light.aside(scene, ground.patches.instances)
            return
        write(self.device, self._camera, camera_of(scene.view, self.terrain, scene.surface.exaggeration))
        encoder = self.device.handle.create_command_encoder()
        self._ground.draw(encoder, targets, ground)
        self.device.queue.submit([encoder.finish()])
        self._light.at_once(scene, lambda: self._seen(scene))
