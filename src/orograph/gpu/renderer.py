"""The terrain renderer: a scene becomes a frame, out of core, at the rate of the screen.

A frame: tiles that were read meanwhile are brought to the atlases; the engine ``batched`` selects patches among those
whose tiles are there (coarser ones stand in, so there is neither hole nor crack nor waiting); one instanced draw leaves
depth and marks; one pass gives every pixel its light. What the frame would have liked to have goes to the streamer,
largest error first. Maps of light follow the camera from a thread of their own. When nothing changes any more, further
frames are drawn with samples elsewhere in the pixels and averaged: a picture at rest is smooth everywhere.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.drape import Drape
from orograph.gpu.aperture import tables as light_tables
from orograph.gpu.aside import Aside
from orograph.gpu.camera import CAMERA, camera_of
from orograph.gpu.device import Device
from orograph.gpu.drape import DrapeTexture
from orograph.gpu.frame import PLAIN, FrameStats, Overlay
from orograph.gpu.lightmaps import LightMaps, light_maps, plain_maps, whole
from orograph.gpu.look import CONTOURS, SHADE, VEILED, WIREFRAME, Look
from orograph.gpu.passes import PatchPass, ResolvePass, ScreenOcclusion, ShadePass, Targets
from orograph.gpu.residency import Residency
from orograph.gpu.veil import EXACT, VeilPass, veils
from orograph.lod.patches.shape import INSTANCE, STEPS, patch_indices, patch_vertices
from orograph.picture.kept import Kept
from orograph.picture.scene import Scene
from orograph.picture.survey import stride
from orograph.store.terrain import Terrain
from orograph.view import View

Array = NDArray[np.float64]

SETTLED = 0.25
"""Seconds the camera must have stood still before maps of light are made for where it is."""

SAMPLES = 16
"""Samples of a pixel that a picture at rest gathers."""


class Renderer:
    """Draws one terrain on one device.

    Args:
        device: where.
        terrain: what; it is read from several threads.
        gpu_memory: bytes of the atlases. memory: bytes of the engine's tables.
        jobs: threads that read tiles.
    """

    def __init__(
        self,
        device: Device,
        terrain: Terrain,
        *,
        gpu_memory: int = 1 << 29,
        memory: int = 1 << 30,
        jobs: int | None = None,
    ) -> None:
        self.device, self.terrain = device, terrain
        self.kept = Kept()
        self.tiles = Residency(device, terrain, gpu_memory, memory, jobs)
        self.heights, self.slopes, self.engine = self.tiles.heights, self.tiles.slopes, self.tiles.engine
        self._camera = device.buffer(CAMERA.itemsize, "UNIFORM", "camera")
        self._shade = device.buffer(SHADE.itemsize, "UNIFORM", "shade")
        legs = self.engine.legs
        self._patches = PatchPass(
            device, self._camera, self.heights.texture, patch_vertices(legs), patch_indices(legs), INSTANCE.itemsize
        )
        self._veil = VeilPass(device, self._camera)
        self._shading = ShadePass(device, self._camera)
        self._corners = ScreenOcclusion(device, self._shading)
        self._resolves: dict[str, ResolvePass] = {}
        self._targets: Targets | None = None
        self._buffers: dict[str, tuple[Any, Any]] = {}
        self._levels = self._level_table()
        self._bare = self._no_drape()
        self._maps: LightMaps | None = None
        self._light = Aside()
        self._at_rest: Any = None
        self._gathered = 0
        self._missing = 0
        self._last_range = (1.0, 1e5)
        self._last_view: View | None = None
        self._moved = 0.0
        self._wish: Any = None

    # ---- drawing ---------------------------------------------------------------------------------------------------

    def draw(
        self, target: Any, format: str, scene: Scene, *, overlay: Overlay = PLAIN, freeze: View | None = None,
        wait: bool = False, samples: int | None = None,
    ) -> FrameStats:  # fmt: skip
        """Draw a frame.

        Args:
            target: a texture view of the scene's view's size, to be overwritten. format: its format.
            scene: what; its terrain must be the renderer's.
            overlay: what is shown besides.
            freeze: the camera that patches are selected for, if not the scene's view.
            wait: first wait for all tiles and maps that the picture wants.
            samples: draw with so many samples per pixel at once; None: one, and one more every further frame at rest.

        Raises:
            OrographError: with ``wait``, a tile or a map could not be made.
        """
        begun = time.perf_counter()
        view = scene.view
        chosen = self.tiles.choose(freeze or view, scene.tolerance or 1.0, scene.exaggeration, wait=wait)
        patches = chosen.patches
        self._missing = chosen.missing
        targets = self._fit(view.width, view.height)
        state = (scene, overlay, freeze, chosen.loaded, len(patches.instances), self._maps_key(scene))
        if samples is None and state == self._at_rest and not self.busy:
            if self._gathered >= SAMPLES:
                begin, count = self._gathered, 0
            else:
                begin, count = self._gathered, 1
        else:
            begin, count = 0, samples or 1
        self._at_rest = state
        instances = patches.instances
        self._light_for(scene, targets, instances, wait=wait)
        assert self._maps is not None
        look = self._look(scene, overlay, exact=wait)
        self.tint = look.tint
        u = look.uniform
        u["contour"] = overlay.contours, overlay.index, overlay.contour_width, overlay.contour_opacity
        u["contour_colour"] = 0.12, 0.075, 0.04, 0.0
        self.device.queue.write_buffer(self._shade, 0, u)
        group = self._group(targets, look, scene)
        flags = int(u["flags"]) | (CONTOURS if overlay.contours > 0 else 0) | (VEILED if self._veil.count else 0)
        if format not in self._resolves:
            self._resolves[format] = ResolvePass(self.device, format)
        self._gathered = begin + count
        encoder = self.device.handle.create_command_encoder()
        for k in range(begin, begin + count):
            shift = _sample(k, samples or SAMPLES) if (samples or SAMPLES) > 1 else (0.0, 0.0)
            if k == 0 and samples is None:
                shift = (0.0, 0.0)
            self._pass(encoder, targets, scene, instances, group, flags, shift, k > 0)
            if k + 1 < begin + count:  # the camera is written before the next pass
                self.device.queue.submit([encoder.finish()])
                encoder = self.device.handle.create_command_encoder()
        dark = None
        if overlay.occlusion > 0 and overlay.reach != 0:
            plan = view.projection == "plan"
            dark = self._corners.encode(
                encoder, targets, group, view.pixel_metres if plan else view.pixel_slope,
                overlay.reach or view.distance / 12, not plan,
            )  # fmt: skip
        self._resolves[format].draw(
            encoder, targets, target, frames=max(self._gathered, 1), occlusion=dark, strength=overlay.occlusion
        )
        took_python = time.perf_counter() - begun
        self.device.queue.submit([encoder.finish()])
        return FrameStats(
            len(instances), patches.stats["triangles"], patches.stats["pixels"], chosen.seconds * 1e3,
            took_python * 1e3, chosen.loaded, chosen.loaded * 4 * 257 * 257, self.tiles.count, self._missing,
            self._gathered, self.tiles.failure,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        """Whether tiles or maps are on their way: the next frame will be better."""
        return self._missing > 0 or self.tiles.waiting > 0 or self._light.busy or self._light.done != self._wish

    @property
    def resting(self) -> bool:
        """Whether the picture is as good as it gets."""
        return not self.busy and self._gathered >= SAMPLES

    def depth_at(self, x: float, y: float) -> float | None:
        """View-space depth of the last frame at a pixel position, metres; None where there is no ground."""
        t = self._targets
        if t is None or not (0 <= x < t.width and 0 <= y < t.height):
            return None
        values = self._read(t.depth, int(x), int(y), 1, 1)
        return float(values[0, 0]) if np.isfinite(values[0, 0]) else None

    def depth(self) -> NDArray[np.float32]:
        """View-space depth (height, width) of the last frame, metres, NaN where there is no ground."""
        t = self._targets
        assert t is not None
        return np.where(self.veiled(), np.float32(np.nan), self._read(t.depth, 0, 0, t.width, t.height))

    def veiled(self) -> NDArray[np.bool_]:
        """Pixels (height, width) of the last frame that show missing ground."""
        t = self._targets
        assert t is not None
        if not self._veil.count:
            return np.zeros((t.height, t.width), bool)
        return self.device.read_texture(t.marks, np.uint32, 1)[..., 0] & 2 > 0

    def shown(self, scene: Scene, depth: NDArray[np.float32], veiled: NDArray[np.bool_]) -> dict[str, int]:
        """How many pixels show ground, of it water and imagery, and missing ground; the middle two by a sample."""
        ground = int(np.isfinite(depth).sum())
        points, share = self._points(scene, depth)
        maps = self._maps
        wet = np.zeros(len(points), bool)
        if maps is not None and maps.wet:
            _, rows, cols, level = maps.light
            field = maps.pool[rows * cols : 2 * rows * cols].reshape(rows, cols)
            at = np.rint((points + 0.5) / 2.0**level - 0.5).astype(np.intp) - np.array(maps.first)[::-1]
            wet = field[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, cols - 1)] > 0.5
        covered = 0
        if scene.drape is not None and len(points):
            x, y = self.terrain.grid.xy(points[:, 0], points[:, 1])
            spacing = float(np.mean(self.terrain.grid.spacing))
            image = self._draped(scene).drape.sample(x, y, np.full(len(points), spacing))
            covered = int(((image[:, 3] > 0.5) & ~wet).sum())
        return {
            "ground": ground, "water": round(int(wet.sum()) * share), "draped": round(covered * share),
            "missing": int(veiled.sum()),
        }  # fmt: skip

    @property
    def light(self) -> str:
        """Where the light of the last frame came from, if it was looked up in a layer."""
        return self._maps.told if self._maps is not None else ""

    def close(self) -> None:
        """Stop reading."""
        self.tiles.close()
        self._light.close()

    # ---- parts of a frame ------------------------------------------------------------------------------------------

    def _pass(
        self, encoder: Any, targets: Targets, scene: Scene, instances: NDArray[Any], group: Any, flags: int,
        shift: tuple[float, float], add: bool,
    ) -> None:  # fmt: skip
        camera = camera_of(scene.view, self.terrain, scene.exaggeration, shift=shift)
        self.device.queue.write_buffer(self._camera, 0, camera)
        self._patches.draw(encoder, targets, instances, edges=bool(flags & WIREFRAME))
        self._veil.draw(encoder, targets)
        self._shading.draw(encoder, targets, group, flags, add=add)

    def _look(self, scene: Scene, overlay: Overlay, *, exact: bool) -> Look:
        """The scene's colours and light: made again only if something of it changed.

        Unless it is to be ``exact`` the range of depths that haze spans is rounded, so that it does not change always.
        """
        assert self._maps is not None
        near, far = scene.depths or self._last_range
        if not exact:
            near, far = (math.exp(round(10 * math.log(max(v, 1e-3))) / 10) for v in (near, far))
        key = (
            scene.sun, scene.light, scene.lamps, scene.discs, scene.shadows, scene.sky, scene.colormap, scene.water,
            scene.relief, scene.exaggeration, scene.drape is None, near, far, overlay.wireframe, overlay.levels,
            overlay.drape_opacity,
        )  # fmt: skip

        def make() -> Look:
            assert self._maps is not None
            return Look(
                scene, self._maps, (near, far), self.kept, wireframe=overlay.wireframe, levels=overlay.levels,
                drape_opacity=overlay.drape_opacity,
            )  # fmt: skip

        return self.kept("look", key, make, self._maps)

    def _fit(self, width: int, height: int) -> Targets:
        if self._targets is None or (self._targets.width, self._targets.height) != (width, height):
            self._targets = Targets(self.device, width, height)
            self._at_rest = None
        return self._targets

    # ---- light -----------------------------------------------------------------------------------------------------

    def _maps_key(self, scene: Scene) -> Any:
        return scene.sun, scene.shadows, scene.exaggeration, scene.water, scene.light

    def _light_for(
        self, scene: Scene, targets: Targets, instances: NDArray[Any], *, wait: bool
    ) -> None:  # fmt: skip
        """Have maps of light for the scene: at once if ``wait``, else aside while old ones serve."""
        if wait:
            camera = camera_of(scene.view, self.terrain, scene.exaggeration)
            self.device.queue.write_buffer(self._camera, 0, camera)
            encoder = self.device.handle.create_command_encoder()
            self._patches.draw(encoder, targets, instances)
            self.device.queue.submit([encoder.finish()])
            points, self._last_range = self._seen(scene)
            self._maps = light_maps(scene, points, self.kept)
            self._veil.load(*self._veils(scene))
            self._light.done = self._wish = self._key(scene)
            return
        done = self._light.take()
        if done is not None:
            self._maps, self._last_range, veil = done
            self._veil.load(*veil)
        if self._maps is None:
            self._maps, self._last_range = plain_maps(), self._about(scene, instances)[1]
        key = self._wish = self._key(scene)
        now = time.monotonic()
        if scene.view != self._last_view:
            self._last_view, self._moved = scene.view, now
        # While the camera moves the maps there are serve on; a new sun, or the first, is not waited with.
        settled = now - self._moved > SETTLED or self._light.done is None or self._light.done[:5] != key[:5]
        if settled and self._light.wants(key):
            points, visible = self._about(scene, instances)
            self._light.start(key, lambda: (light_maps(scene, points, Kept(), detail=1.5), visible, self._veils(scene)))

    def _veils(self, scene: Scene) -> tuple[NDArray[Any], NDArray[np.uint32]]:
        """Patches over the holes in view."""
        view, terrain, tolerance = scene.view, self.terrain, scene.tolerance or 1.0
        known = () if terrain.grid.shape[0] * terrain.grid.shape[1] <= EXACT else (view, scene.exaggeration, tolerance)
        return self.kept("veils", known, lambda: veils(terrain, view, scene.exaggeration, tolerance), terrain)

    def _key(self, scene: Scene) -> Any:
        view = scene.view
        eye = np.asarray(view.eye)
        step = 0.15 * max(view.distance, 1.0)
        return (
            *self._maps_key(scene),
            tuple(np.floor(eye / step).tolist()),
            tuple(np.floor(np.array(view.target) / step)),
        )

    def _about(self, scene: Scene, instances: NDArray[Any]) -> tuple[Array, tuple[float, float]]:
        """What ``_seen`` finds, by where patches lie: without asking the GPU, which would have to be waited for."""
        if not len(instances):
            return whole(self.terrain), self._last_range
        grid = self.terrain.grid
        reach = self.engine.legs * (1 << instances["step"].astype(np.int64))
        steps = STEPS[instances["omega"]].astype(np.int64)
        row, col = instances["row"].astype(np.int64), instances["col"].astype(np.int64)
        rows = np.concatenate([row, row + reach * steps[:, 0, 0], row + reach * steps[:, 1, 0]])
        cols = np.concatenate([col, col + reach * steps[:, 0, 1], col + reach * steps[:, 1, 1]])
        points = np.stack([np.clip(cols, 0, grid.cols - 1), np.clip(rows, 0, grid.rows - 1)], 1).astype(np.float64)
        x, y = grid.xy(points[:, 0], points[:, 1])
        middle = sum(self.terrain.height_range) / 2
        pixels, depth = scene.view.project(np.stack([x, y, np.full(len(x), middle)], -1), scene.exaggeration)
        inside = (depth > 0) & (
            np.abs(pixels - [scene.view.width / 2, scene.view.height / 2])
            <= [0.6 * scene.view.width, 0.6 * scene.view.height]
        ).all(-1)
        if not inside.any():
            return points, self._last_range
        return points[inside], (float(depth[inside].min()), float(depth[inside].max()))

    def _seen(self, scene: Scene) -> tuple[Array, tuple[float, float]]:
        """Sample coordinates (n, 2) of some of the ground in view, by the last frame's depth, and the depths' range."""
        depth = self.depth()
        points, _ = self._points(scene, depth)
        if len(points) == 0:
            return whole(self.terrain), self._last_range
        return points, (float(np.nanmin(depth)), float(np.nanmax(depth)))

    def _points(self, scene: Scene, depth: NDArray[np.float32]) -> tuple[Array, float]:
        """Sample coordinates (n, 2) of evenly spread pixels that show ground, and how many pixels each stands for."""
        step = stride(*depth.shape)
        some = depth[::step, ::step]
        rows, cols = np.nonzero(np.isfinite(some))
        o0, ou, ov, d0, du, dv = scene.view.ray_basis(scene.exaggeration)
        px, py = (cols * step + 0.5)[:, None], (rows * step + 0.5)[:, None]
        t = some[rows, cols].astype(np.float64)[:, None]
        at = o0 + px * ou + py * ov + t * (d0 + px * du + py * dv)
        col, row = self.terrain.grid.index(at[:, 0], at[:, 1])
        col = np.clip(col, 0, self.terrain.grid.cols - 1)
        row = np.clip(row, 0, self.terrain.grid.rows - 1)
        return np.stack([col, row], 1), float(step * step)

    # ---- resources -------------------------------------------------------------------------------------------------

    def _group(self, targets: Targets, look: Look, scene: Scene) -> Any:
        assert self._maps is not None
        windows = np.concatenate([self._maps.windows, self._maps.fields])
        if not len(windows):
            windows = np.zeros((1, 8), np.int32)
        suns, lamps = light_tables(look.lights, *self._from_eye(scene))
        image, lattice = self._bare
        if scene.drape is not None:
            draped = self._draped(scene)
            draped.aim(scene.view)
            image, lattice = draped.view, draped.lattice
        return self._shading.group(
            targets,
            {
                0: self._shade,
                3: self.slopes.texture.create_view(dimension="2d-array"),
                4: self.slopes.page_buffer,
                5: self._stored("tables", look.tables),
                6: self._stored("maps", self._maps.pool),
                7: self._levels,
                8: self._stored("windows", windows),
                9: image,
                11: lattice,
                12: self._stored("suns", suns),
                13: self._stored("lamps", lamps),
            },
        )

    def _from_eye(self, scene: Scene) -> tuple[Array, Array]:
        """Metres east and north per column and row, and where the eye is from sample (0, 0), stretched height."""
        a, b, c, d, e, f = self.terrain.grid.samples[:6]
        view = scene.view
        x, y = view.target[:2] if view.projection == "plan" else view.eye[:2]
        origin = np.array([x - c, y - f, view.eye[2] * scene.exaggeration])
        return np.array([[a, b], [d, e]]), origin

    def _stored(self, name: str, values: NDArray[Any]) -> Any:
        """A storage buffer with these values; written again only if they are other ones."""
        held = self._buffers.get(name)
        if held is not None and held[1] is values:
            return held[0]
        if held is not None and held[0].size == -(-values.nbytes // 4) * 4:
            if not np.array_equal(held[1], values):
                self.device.queue.write_buffer(held[0], 0, np.ascontiguousarray(values))
            self._buffers[name] = held[0], values
            return held[0]
        buffer = self.device.buffer(values, "STORAGE", name)
        self._buffers[name] = buffer, values
        return buffer

    def _level_table(self) -> Any:
        terrain, tables = self.terrain, self.slopes.tables
        table = np.zeros((terrain.levels, 8), np.uint32)
        for k in range(terrain.levels):
            table[k, :5] = tables.offsets[k], *tables.shapes[k], *terrain.mean_shape(k)
        return self.device.buffer(table, "STORAGE", "levels")

    def _no_drape(self) -> tuple[Any, Any]:
        texture = self.device.texture((1, 1), "rgba8unorm-srgb", "TEXTURE_BINDING|COPY_DST", label="no drape")
        return texture.create_view(), self.device.buffer(np.zeros((7, 4), np.float32), "STORAGE", "no drape")

    def _draped(self, scene: Scene) -> DrapeTexture:
        """The scene's image, read and uploaded when it is first asked for."""
        path, terrain, memory = scene.drape, self.terrain, scene.max_memory
        assert path is not None

        def upload() -> DrapeTexture:
            return DrapeTexture(self.device, Drape.open(path, terrain.grid, memory))

        return self.kept("drape on the GPU", (path, memory), upload, terrain)

    def _read(self, texture: Any, x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        data = self.device.queue.read_texture(
            {"texture": texture, "origin": (x, y, 0), "aspect": "depth-only"},
            {"offset": 0, "bytes_per_row": 4 * width, "rows_per_image": height},
            (width, height, 1),
        )
        return self._metres(np.frombuffer(data, np.float32).reshape(height, width))

    def _metres(self, stored: NDArray[np.float32]) -> NDArray[np.float32]:
        near, far, plan = self._depth_range
        with np.errstate(divide="ignore"):
            metres = far - stored * (far - near) if plan else near / stored
        return np.where(stored > 0, metres, np.nan).astype(np.float32)

    @property
    def _depth_range(self) -> tuple[float, float, bool]:
        scene = self._at_rest[0]
        camera = camera_of(scene.view, self.terrain, scene.exaggeration)
        return float(camera["near"]), float(camera["far"]), bool(camera["plan"])


def _sample(k: int, n: int) -> tuple[float, float]:
    """Where the k-th of n samples lies, pixels from the middle: as the CPU's pictures have it (``cpu.pattern``)."""
    from orograph.picture.cpu import pattern

    x, y = pattern(n)[k % n]
    return float(x) - 0.5, float(y) - 0.5
