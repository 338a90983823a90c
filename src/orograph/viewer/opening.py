"""Prepare a canvas for drawing, and show a sentence on it while a terrain is opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from imgui_bundle import imgui

from orograph.gpu.device import Device
from orograph.viewer.bookmarks import config_folder
from orograph.viewer.gui import Gui

Opened = tuple[Gui, Any, str]
"""A canvas's panels, its context, and the format of its textures."""


def open_canvas(
    canvas: Any, device: Device, clipboard: tuple[Callable[[], str], Callable[[str], None]] | None = None
) -> Opened:
    """Prepare a canvas for drawing on a device, with panels laid out as last time."""
    context = canvas.get_wgpu_context()
    format = str(context.get_preferred_format(device.adapter.handle))
    context.configure(device=device.handle, format=format)
    layout: Path | None = config_folder() / "layout.ini"
    try:
        config_folder().mkdir(parents=True, exist_ok=True)
    except OSError:
        layout = None
    return Gui(device, format, layout, clipboard), context, format


def announce(canvas: Any, device: Device, opened: Opened, text: str) -> None:
    """Draw a sentence on a canvas at once, to show something while a terrain is opened."""
    gui, context, _ = opened

    def draw() -> None:
        gui.begin(canvas.get_logical_size(), float(canvas.get_pixel_ratio()) or 1.0, 1 / 60)
        width, height = canvas.get_logical_size()
        ink = imgui.get_background_draw_list()
        ink.add_text(
            ((width - imgui.calc_text_size(text).x) / 2, height / 2), imgui.get_color_u32((0.8, 0.82, 0.85, 1)), text
        )  # fmt: skip
        drawing = gui.end()
        encoder = device.handle.create_command_encoder()
        target = context.get_current_texture().create_view()
        done = encoder.begin_render_pass(
            color_attachments=[
                {"view": target, "clear_value": (0.012, 0.014, 0.017, 1), "load_op": "clear", "store_op": "store"}
            ]
        )
        gui.backend.render(drawing, done)
        done.end()
        device.queue.submit([encoder.finish()])

    canvas.request_draw(draw)
    for _ in range(2):  # fonts become available with the first frame
        canvas._process_events()
        canvas.force_draw()
