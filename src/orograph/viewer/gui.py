"""Dear ImGui on a canvas: fonts, colours, the saved layout, and the target of an event.

wgpu-py's own glue uses the last frame's state to decide whether an event is for ImGui. With frames drawn on demand that
state is stale (a move and a press arrive together), so here the window under the pointer is looked up when a press
comes. Events are taken from ``rendercanvas``; positions are logical pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from imgui_bundle import imgui, implot

from orograph.gpu.device import Device

FONT = 15.0
"""Logical pixels."""

FRAMES = 3
"""Frames until a pressed text field has the keyboard."""

INK = (0.93, 0.94, 0.95, 1.0)
PAPER = (0.105, 0.115, 0.13, 0.94)
ACCENT = (0.35, 0.62, 0.86, 1.0)

_MODIFIERS = {"Shift": "mod_shift", "Control": "mod_ctrl", "Alt": "mod_alt", "Meta": "mod_super"}


class Gui:
    """ImGui's context and its renderer on a device.

    Args:
        device: where it draws; ``format``: of the canvas's textures.
        layout: the file that stores the positions of panels, or None.
        clipboard: functions that get and set the clipboard's text, or None for ImGui's own.
    """

    def __init__(
        self,
        device: Device,
        format: str,
        layout: Path | None = None,
        clipboard: tuple[Callable[[], str], Callable[[str], None]] | None = None,
    ) -> None:
        self.context = imgui.create_context()
        imgui.set_current_context(self.context)
        self.plots = implot.create_context()
        self._layout = "" if layout is None else str(layout)
        self.rebuild(device, format)
        io = imgui.get_io()
        io.config_flags |= imgui.ConfigFlags_.docking_enable
        io.config_windows_move_from_title_bar_only = True
        io.config_error_recovery_enable_assert = False
        self.fresh = layout is None or not _places_panels(layout)
        self._later: list[tuple[Callable[[], None], bool | None]] = []
        """Queued input, and whether it is about a button; None: about neither button nor pointer."""
        self._fresh_pointer = False
        self._expecting = 0
        self.raised: list[str] = []
        """Panels to bring to the top of their stacks, one per frame."""
        if clipboard is not None:
            get, put = clipboard
            platform = imgui.get_platform_io()
            platform.platform_get_clipboard_text_fn = lambda _: get()
            platform.platform_set_clipboard_text_fn = lambda _, text: put(text)
        font = files("imgui_bundle").joinpath("assets", "fonts", "DroidSans.ttf")
        if font.is_file():
            io.fonts.add_font_from_file_ttf(str(font), FONT)
        _style()

    def rebuild(self, device: Device, format: str) -> None:
        """Draw with another device after the last one was lost."""
        from wgpu.utils.imgui import ImguiWgpuBackend

        imgui.set_current_context(self.context)
        self.backend = ImguiWgpuBackend(device.handle, format)
        # The backend sets an empty name for the layout's file; set ours after that.
        imgui.get_io().set_ini_filename(self._layout)
        for texture in imgui.get_platform_io().textures:  # another backend's resources are gone with its device
            status = imgui.ImTextureStatus
            if texture.status in (status.ok, status.want_updates):
                texture.set_tex_id(0)
                texture.set_status(status.want_create)
                whole = texture.update_rect  # the backend provides this part
                whole.x, whole.y, whole.w, whole.h = 0, 0, texture.width, texture.height
            elif texture.status == status.want_destroy:
                texture.set_tex_id(0)
                texture.set_status(status.destroyed)

    # ---- events --------------------------------------------------------------------------------------------------

    def pointer(self, x: float, y: float) -> None:
        """Move the pointer to (x, y)."""
        self._do(partial(self._io().add_mouse_pos_event, x, y), False)

    def left(self) -> None:
        """Take the pointer away, unless it drags something."""
        imgui.set_current_context(self.context)
        if not imgui.is_any_mouse_down():
            self.pointer(-imgui.FLT_MAX, -imgui.FLT_MAX)

    def button(self, button: int, down: bool) -> None:
        """Press or release a button (1 left, 2 right, 3 middle)."""
        if 1 <= button <= 5:
            self._do(partial(self._io().add_mouse_button_event, button - 1, down), True)

    def _do(self, tell: Callable[[], None], button: bool) -> None:
        """Queue a mouse event. A button waits for a frame with the pointer in place: a quick click on a tab that
        arrives together with the move would be lost."""
        if self._later or (button and self._fresh_pointer):
            self._later.append((tell, button))
        else:
            self._fresh_pointer |= not button
            tell()

    def _then(self, tell: Callable[[], None]) -> None:
        """Queue a keyboard or wheel event after those that wait: a released Ctrl would otherwise overtake its click."""
        if self._later:
            self._later.append((tell, None))
        else:
            tell()

    def _tell_later(self) -> None:
        """Pass on the events that waited for a frame, up to and including one button."""
        while self._later:
            tell, button = self._later[0]
            if button and self._fresh_pointer:
                return
            self._later.pop(0)
            self._fresh_pointer |= button is False
            tell()
            if button:
                return

    @property
    def waiting(self) -> bool:
        """Whether events wait for a frame: here, or in ImGui, which takes one change of a key or button a frame."""
        imgui.set_current_context(self.context)
        context: Any = imgui.get_current_context()
        return bool(self._later or len(context.input_events_queue))

    @property
    def undecided(self) -> bool:
        """Whether a press on a panel is not drawn yet: it may be on a text field that takes the next keys."""
        return self._expecting > 0

    def pressed(self) -> None:
        """A button was pressed over a panel."""
        self._expecting = FRAMES

    def wheel(self, dx: float, dy: float) -> None:
        """Turn the wheel, in notches."""
        self._then(partial(self._io().add_mouse_wheel_event, dx, dy))

    def key(self, name: str, down: bool) -> None:
        """Press or release a key, by ``rendercanvas``'s name."""
        from wgpu.utils.imgui import ImguiRenderer

        key: Any = ImguiRenderer.KEY_MAP.get(name)
        if key is None:
            letter = name.lower()
            if len(letter) != 1:
                return
            if letter.isdigit():
                key = imgui.Key(imgui.Key._0.value + int(letter))
            elif "a" <= letter <= "z":
                key = imgui.Key(imgui.Key.a.value + ord(letter) - ord("a"))
            else:
                return
        io = self._io()
        self._then(partial(io.add_key_event, key, down))
        if name in _MODIFIERS:
            self._then(partial(io.add_key_event, getattr(imgui.Key, _MODIFIERS[name]), down))

    def text(self, characters: str) -> None:
        """Type characters."""
        if characters:
            self._then(partial(self._io().add_input_characters_utf8, characters))

    def over(self, x: float, y: float) -> bool:
        """Whether a panel (or an open menu) is at (x, y)."""
        imgui.set_current_context(self.context)
        if imgui.get_frame_count() == 0:
            return False
        imgui.internal.update_hovered_window_and_capture_flags((x, y))
        return bool(imgui.get_io().want_capture_mouse)

    @property
    def typing(self) -> bool:
        """Whether keys are for a text field."""
        return bool(self._io().want_text_input)

    def _io(self) -> Any:
        imgui.set_current_context(self.context)
        return imgui.get_io()

    # ---- frames --------------------------------------------------------------------------------------------------

    def begin(self, size: tuple[float, float], ratio: float, seconds: float) -> None:
        """Begin a frame of ``size`` logical pixels."""
        io = self._io()
        self._tell_later()
        implot.set_current_context(self.plots)
        io.display_size = size
        io.display_framebuffer_scale = (ratio, ratio)
        io.delta_time = max(seconds, 1e-4)
        imgui.new_frame()
        self._fresh_pointer = False
        self._expecting -= bool(self._expecting and not self.waiting)

    def end(self) -> Any:
        """End the frame; returns its draw data."""
        imgui.render()
        return imgui.get_draw_data()

    def close(self) -> None:
        """Destroy the context; the layout is saved."""
        imgui.set_current_context(self.context)
        implot.destroy_context(self.plots)
        imgui.destroy_context(self.context)


def _places_panels(layout: Path) -> bool:
    """Whether a layout's file contains panel positions: that of a window that never showed panels does not."""
    try:
        return "DockId=" in layout.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


def _style() -> None:
    """Quiet dark panels beside the picture."""
    imgui.style_colors_dark()
    style: Any = imgui.get_style()
    style.window_rounding = 4.0
    style.frame_rounding = 3.0
    style.grab_rounding = 3.0
    style.popup_rounding = 4.0
    style.window_border_size = 0.0
    style.frame_border_size = 1.0  # otherwise unchosen radio buttons and empty boxes are hardly visible
    style.item_spacing = (8.0, 6.0)
    style.window_padding = (10.0, 8.0)
    c = imgui.Col_
    for which, color in (
        (c.window_bg, PAPER), (c.popup_bg, (0.08, 0.09, 0.10, 1)), (c.text, INK), (c.title_bg, (0.08, 0.09, 0.10, 1)),
        (c.title_bg_active, (0.13, 0.15, 0.18, 1)), (c.border, (0.62, 0.70, 0.80, 0.38)),
        (c.border_shadow, (0, 0, 0, 0)), (c.text_disabled, (0.62, 0.65, 0.69, 1)), (c.separator, (0.3, 0.33, 0.37, 1)),
        (c.frame_bg, (0.18, 0.20, 0.23, 1)), (c.frame_bg_hovered, (0.23, 0.26, 0.30, 1)),
        (c.frame_bg_active, (0.25, 0.30, 0.36, 1)), (c.slider_grab, ACCENT), (c.slider_grab_active, ACCENT),
        (c.check_mark, ACCENT), (c.button, (0.20, 0.25, 0.31, 1)), (c.button_hovered, (0.26, 0.36, 0.46, 1)),
        (c.button_active, ACCENT), (c.header, (0.20, 0.25, 0.31, 1)), (c.header_hovered, (0.26, 0.36, 0.46, 1)),
        (c.tab, (0.12, 0.14, 0.16, 1)), (c.tab_selected, (0.20, 0.25, 0.31, 1)), (c.tab_hovered, (0.26, 0.36, 0.46, 1)),
    ):  # fmt: skip
        style.set_color_(which, color)
