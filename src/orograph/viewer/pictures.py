"""Save pictures of a window: the terrain with all tiles and smooth edges, and the view beside it as JSON."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.errors import OrographError

if TYPE_CHECKING:
    from orograph.viewer.window import Window

SAMPLES = 16
"""Samples per pixel."""


class Pictures:
    """Saves what a window shows.

    Attributes:
        asked: the file to write the next finished frame to, or None.
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self.asked: Path | None = None

    def ask(self) -> None:
        """Save the visible terrain, and the view beside it, once this frame is drawn."""
        session = self.window.session
        stem = "".join(c if c.isalnum() or c in "-_." else "-" for c in session.terrain.name)
        self.asked = Path.cwd() / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}.png"
        session.messages.say("Saving a picture, with all tiles and smooth edges.")

    def save(self) -> None:
        """Write the requested picture, and report it."""
        path, self.asked = self.asked, None
        if path is None:
            return
        session = self.window.session
        try:
            self.write(path)
            path.with_suffix(".json").write_text(session.view_json() + "\n", encoding="utf-8")
        except (OrographError, OSError) as error:
            session.messages.say(f"The picture was not saved: {error}", error=True)
        else:
            session.messages.say(f"Saved {path.name}, and its view as {path.stem}.json, in {path.parent}.")
        self.window.touch()

    def write(self, path: Path, *, panels: bool = False) -> None:
        """Write the terrain's picture with all tiles; ``panels``: the whole window's.

        Raises:
            OutputError: it cannot be written.
        """
        from PIL import Image

        from orograph.output import Beside

        window = self.window
        window.drawing.exact(SAMPLES)
        screen = window.drawing.screen
        if panels:
            size = window.canvas.get_physical_size()
            texture = window.device.texture(size, screen.format, "RENDER_ATTACHMENT|COPY_SRC", label="window")
            window.compose(texture.create_view(), size, imgui.get_draw_data())
            pixels = screen.read(texture)
        else:
            pixels = screen.pixels()
        with Beside(path) as part:
            Image.fromarray(pixels).save(part, format="PNG")
