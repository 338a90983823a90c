"""The plan: a small map of the whole terrain in the window, with the camera's footprint; click it to go there.

A thread draws its relief once with the CPU ray caster, at the displayed size. The footprint is where the rays of the
picture's border meet a plane at the height of the target, within the terrain's reach. The plan is hidden, an inset, or
takes half of the window. Units: logical pixels; metres.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.rendering.furniture.pieces import bar_length
from orograph.rendering.picture import plan_grid
from orograph.scene import camera
from orograph.viewer.wording import spoken
from orograph.viewpoint import Point, View

if TYPE_CHECKING:
    from orograph.viewer.window import Area, Window

Mode = Literal["inset", "half", "none"]
NEXT: dict[Mode, Mode] = {"inset": "half", "half": "none", "none": "inset"}
MOST = 1024
"""Pixels along the longer side of the relief."""
INSET = 0.3
"""Part of the area's shorter side that the inset takes."""
AROUND = 12
"""Rays along each side of the picture's border."""

Array = NDArray[np.float64]


class Plan:
    """The plan of a window.

    Attributes:
        mode: how it is shown. view: of the relief drawn, or None. trouble: why there is none, or "".
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self.mode: Mode = "inset"
        self.view: View | None = None
        self.trouble = ""
        self._rect: Area = (0.0, 0.0, 0.0, 0.0)
        self._pixels: NDArray[np.uint8] | None = None
        self._drawing: tuple[int, int] | None = None
        self._texture: Any = None
        self._dragging = False
        self._visible = False

    @property
    def busy(self) -> bool:
        """Whether its relief is being drawn."""
        return self._drawing is not None

    @property
    def wanted(self) -> bool:
        """Whether it is shown but its relief is not ready."""
        return self._visible and self._texture is None and not self.trouble

    @property
    def inset_width(self) -> float:
        """Logical pixels that the inset takes at the left of the terrain's area."""
        return self._rect[2] if self.mode == "inset" else 0.0

    def cycle(self) -> None:
        """Cycle through inset, half and none."""
        self.mode = NEXT[self.mode]

    def place(self, area: Area) -> Area:
        """Take its place in the area; returns what is left for the terrain."""
        x, y, w, h = area
        if self.mode == "half" and w > 200:
            self._rect = x, y, math.floor(w / 2), h
            return x + self._rect[2], y, w - self._rect[2], h
        side = max(120.0, min(w, h) * INSET)
        rows, cols = self.window.session.terrain.grid.shape
        wide, tall = (side, side * rows / cols) if cols >= rows else (side * cols / rows, side)
        self._rect = x + 14, y + 14, max(wide, 60.0), max(tall, 60.0)
        return area

    def draw(self) -> None:
        """Draw the relief and the footprint, and handle the mouse."""
        x, y, w, h = self._rect
        small = self.mode == "inset" and (self.window.area[2] < 420 or self.window.area[3] < 300)
        self._visible = self.mode != "none" and not small
        if not self._visible:
            return
        imgui.set_next_window_pos((x, y))
        imgui.set_next_window_size((w, h))
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings
        flags |= imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_bring_to_front_on_focus
        imgui.push_style_var(imgui.StyleVar_.window_padding, (0.0, 0.0))
        imgui.begin("##plan", None, flags)
        imgui.pop_style_var()
        self._relief(w, h)
        canvas = imgui.get_window_draw_list()
        if self._texture is not None:
            left, top, wide, tall = self._map
            canvas.add_image(self._texture[0], (left, top), (left + wide, top + tall))
        elif self.trouble:
            imgui.text_wrapped(spoken(self.trouble))
        if self.view is not None:
            canvas.push_clip_rect((x, y), (x + w, y + h), True)
            self._tour(canvas)
            self._footprint(canvas)
            self._hidden(canvas)
            self._scale(canvas)
            canvas.pop_clip_rect()
            self._mouse()
        edge = imgui.get_color_u32((0, 0, 0, 0.7))
        canvas.add_rect((x, y), (x + w, y + h), edge, 0.0, 1.0)
        imgui.end()

    # ---- places ----------------------------------------------------------------------------------------------------

    @property
    def _map(self) -> Area:
        """The rectangle of the relief: centred in the plan, as large as fits; one of another size is not stretched."""
        assert self.view is not None
        x, y, w, h = self._rect
        scale = min(w / self.view.width, h / self.view.height)
        wide, tall = scale * self.view.width, scale * self.view.height
        return x + (w - wide) / 2, y + (h - tall) / 2, wide, tall

    def to_screen(self, points: Array) -> Array:
        """Logical pixels (n, 2) of places (n, 2) in the terrain's CRS."""
        assert self.view is not None
        grid = plan_grid(self.view, None)
        assert grid is not None
        col, row = grid.index(points[:, 0], points[:, 1])
        x, y, w, h = self._map
        return np.stack([x + (col + 0.5) * w / self.view.width, y + (row + 0.5) * h / self.view.height], 1)

    def to_ground(self, x: float, y: float) -> tuple[float, float]:
        """The place in the terrain's CRS at logical pixels."""
        assert self.view is not None
        grid = plan_grid(self.view, None)
        assert grid is not None
        left, top, w, h = self._map
        e, n = grid.xy((x - left) / w * self.view.width - 0.5, (y - top) / h * self.view.height - 0.5)
        return float(e), float(n)

    # ---- the relief ------------------------------------------------------------------------------------------------

    def _relief(self, w: float, h: float) -> None:
        """Have the relief drawn at this size, and upload it to the GPU when ready."""
        ratio = self.window.ratio * min(1.0, MOST / (max(w, h) * self.window.ratio))
        size = max(32, round(w * ratio)), max(32, round(h * ratio))
        have = None if self.view is None else (self.view.width, self.view.height)
        if self._pixels is not None and self.view is not None:
            self._upload(self._pixels)
            self._pixels = None
        if self._drawing is None and have != size and not self.trouble and self.window.drawing.drawn > 2:
            self._drawing = size
            self.window.session.probe.submit(lambda: self._make(size))

    def _make(self, size: tuple[int, int]) -> None:
        from orograph.rendering.cpu.draw import draw
        from orograph.scene.scene import Scene

        session = self.window.session
        terrain = session.terrain
        try:
            view = camera.plan(terrain, size)
            picture = draw(Scene.of(terrain, view, samples=1, tolerance=1.0, jobs=1, max_memory=256 << 20))
            pixels = np.full((*picture.pixels.shape[:2], 4), 255, np.uint8)
            pixels[..., :3] = picture.pixels
            pixels[~np.isfinite(picture.depth)] = (26, 29, 33, 255)
            if session.terrain is terrain:
                self.view, self._pixels = view, pixels
        except (OrographError, OSError) as error:
            if session.terrain is terrain:
                self.trouble = f"There is no plan: {error}"
        finally:
            if session.terrain is terrain:
                self._drawing = None
        session.changed()

    def _upload(self, pixels: NDArray[np.uint8]) -> None:
        device, backend = self.window.device, self.window.gui.backend
        if self._texture is not None:
            backend.unregister_texture(self._texture[0])
        height, width = pixels.shape[:2]
        texture = device.texture((width, height), "rgba8unorm", "TEXTURE_BINDING|COPY_DST", label="plan")
        device.queue.write_texture(
            {"texture": texture}, np.ascontiguousarray(pixels), {"bytes_per_row": 4 * width}, (width, height, 1)
        )
        view = texture.create_view()
        self._texture = backend.register_texture(view), view, texture

    def forget_texture(self) -> None:
        """Draw the relief again after the device was lost."""
        self._texture, self.view, self._pixels = None, None, None

    def forget(self) -> None:
        """Draw the relief of a new terrain."""
        self.forget_texture()
        self.trouble, self._drawing = "", None

    # ---- what is over it -------------------------------------------------------------------------------------------

    def _footprint(self, canvas: Any) -> None:
        session = self.window.session
        view = session.view
        outline = footprint(view, session.settings.exaggeration, self._far())
        ink, fill = imgui.get_color_u32((1, 1, 1, 0.95)), imgui.get_color_u32((1, 1, 1, 0.16))
        dark = imgui.get_color_u32((0, 0, 0, 0.55))
        eye = tuple(self.to_screen(np.array([view.eye[:2]]))[0])
        if outline is not None:
            corners = [tuple(p) for p in self.to_screen(outline)]
            canvas.add_concave_poly_filled(corners, fill)
            canvas.add_polyline(corners, dark, 3.0, imgui.ImDrawFlags_.closed)
            canvas.add_polyline(corners, ink, 1.3, imgui.ImDrawFlags_.closed)
            for corner in (corners[0], corners[AROUND]):
                canvas.add_line(eye, corner, dark, 1.0)
        canvas.add_circle_filled(eye, 5.0, imgui.get_color_u32((0.05, 0.06, 0.07, 1)))
        canvas.add_circle_filled(eye, 3.5, imgui.get_color_u32((0.98, 0.75, 0.2, 1)))
        hit = session.probe.hit
        if hit is not None and self.window.pointer is not None:
            at = tuple(self.to_screen(np.array([[hit.easting, hit.northing]]))[0])
            canvas.add_circle(at, 4.0, imgui.get_color_u32((0.9, 0.2, 0.15, 1)), 16, 1.6)

    def _tour(self, canvas: Any) -> None:
        """The path of the tour with its stops, and thinly the path of its targets."""
        touring = self.window.touring
        way = touring.way()
        if not len(way):
            return
        dark, ink = imgui.get_color_u32((0, 0, 0, 0.55)), imgui.get_color_u32((0.35, 0.75, 1.0, 1))
        looked, line = ([tuple(p) for p in self.to_screen(way[:, k, :2])] for k in (1, 0))
        canvas.add_polyline(looked, imgui.get_color_u32((0.35, 0.75, 1.0, 0.5)), 1.0, 0)
        canvas.add_polyline(line, dark, 3.5, 0)
        canvas.add_polyline(line, ink, 1.6, 0)
        places = self.to_screen(np.array([s.key.view.eye[:2] for s in touring.stops]))
        for k, place in enumerate(places):
            at = tuple(place)
            canvas.add_circle_filled(at, 5.0 if k == touring.chosen else 3.8, dark)
            canvas.add_circle_filled(at, 4.0 if k == touring.chosen else 2.8, ink)

    def _hidden(self, canvas: Any) -> None:
        """What of a selection the ground hides, while the camera is at the best view of it."""
        finder = self.window.finder
        if not finder.at_best or not len(finder.hidden):
            return
        dark, ink = imgui.get_color_u32((0, 0, 0, 0.7)), imgui.get_color_u32((0.84, 0.37, 0.0, 1))
        for place in self.to_screen(finder.hidden):
            canvas.add_circle_filled(tuple(place), 2.6, dark)
            canvas.add_circle_filled(tuple(place), 1.8, ink)

    def _far(self) -> float:
        """The maximum reach of a footprint, metres: twice the terrain's diagonal."""
        west, south, east, north = self.window.session.terrain.grid.bounds()
        return 2.0 * math.hypot(east - west, north - south)

    def _scale(self, canvas: Any) -> None:
        assert self.view is not None
        x, y, w, h = self._rect
        metres = self.view.pixel_metres * self.view.width / self._map[2]
        length, _, text = bar_length(metres * min(90.0, 0.4 * w))
        wide, top = length / metres, y + h - 10
        canvas.add_rect_filled(
            (x + 6, top - 18), (x + wide + 18, y + h - 4), imgui.get_color_u32((0.06, 0.07, 0.08, 0.6)), 3
        )
        canvas.add_rect_filled((x + 12, top - 2), (x + 12 + wide, top + 1), imgui.get_color_u32((1, 1, 1, 0.95)))
        canvas.add_text((x + 12, top - 18), imgui.get_color_u32((1, 1, 1, 0.95)), text)

    def _mouse(self) -> None:
        io = imgui.get_io()
        nav = self.window.session.nav
        if imgui.is_window_hovered() and imgui.is_mouse_clicked(0):
            self._dragging = False
            point = self._point(io.mouse_pos.x, io.mouse_pos.y)
            nav.go_to(point)
        elif imgui.is_window_hovered() and imgui.is_mouse_dragging(0, 4.0):
            self._dragging = True
        if self._dragging and imgui.is_mouse_down(0):
            nav.jump(centred(nav.view, self._point(io.mouse_pos.x, io.mouse_pos.y), nav.centre()))
        else:
            self._dragging = False

    def _point(self, x: float, y: float) -> Point:
        e, n = self.to_ground(x, y)
        height = self.window.session.probe.ground(e, n)
        return e, n, self.window.session.view.target[2] if math.isnan(height) else height


def centred(view: View, point: Point, middle: Point) -> View:
    """The view moved sideways so that the point at ``middle`` moves to another point."""
    from dataclasses import replace

    dx, dy = point[0] - middle[0], point[1] - middle[1]
    (ex, ey, ez), (tx, ty, tz) = view.eye, view.target
    return replace(view, eye=(ex + dx, ey + dy, ez), target=(tx + dx, ty + dy, tz))


def footprint(view: View, exaggeration: float, far: float) -> Array | None:
    """The points where rays of the picture's border meet the plane at the target's height: (4·``AROUND``, 2), in order.

    Rays that do not meet it within ``far`` metres end there. None if none meets it.
    """
    t = np.linspace(0.0, 1.0, AROUND, endpoint=False)
    zero, one = np.zeros_like(t), np.ones_like(t)
    x = np.concatenate([t, one, 1 - t, zero]) * view.width
    y = np.concatenate([zero, t, one, 1 - t]) * view.height
    o0, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    origin = o0 + x[:, None] * ou + y[:, None] * ov
    ray = d0 + x[:, None] * du + y[:, None] * dv
    level = np.hypot(ray[:, 0], ray[:, 1])
    fall = origin[:, 2] - view.target[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(ray[:, 2] * fall < 0, -fall / ray[:, 2], math.inf)
        end = np.where(level > 0, far / level, math.inf)
    if not np.isfinite(reach).any():
        return None
    s = np.minimum(reach, end)
    s = np.where(np.isfinite(s), s, 0.0)
    return np.asarray(origin[:, :2] + s[:, None] * ray[:, :2])
