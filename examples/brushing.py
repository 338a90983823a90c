"""The window with a selection, off screen: python examples/brushing.py DEM DATA VARIABLE LOW:HIGH OUT.jpg

DATA is as of ``--data``. The panel Plot shows a scatter plot of the variable and the height. Needs the extra ``view``.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from PIL import Image
from rendercanvas.offscreen import RenderCanvas

import orograph
from orograph.viewer.app import renderer_of
from orograph.viewer.panels import plot
from orograph.viewer.session import Session
from orograph.viewer.window import Window

SIZE, SECONDS = (1280, 800), 12


def main(dem: str, data: str, variable: str, span: str, out: str) -> None:
    terrain = orograph.terrain(dem)
    session = Session(terrain, None, size=SIZE, data=orograph.Dataset.parse(data), exaggeration=30, priority="T+D+U-")
    window = Window(session, RenderCanvas(size=SIZE), renderer_of())
    low, high = map(float, span.split(":"))
    end, begun = time.monotonic() + SECONDS, False
    while time.monotonic() < end:
        window.canvas._process_events()  # what a loop would do
        pixels = np.asarray(window.canvas.draw())[..., :3]
        if not begun and window.session.settings.shown is not None:
            begun = True
            window.gui.raised = ["Plot"]
            window.texts |= {"plot x": variable, "plot y": "Height"}
            plot.select(window, ranges={variable: (low, high)})
    Image.fromarray(pixels).save(out, quality=88)
    window.gui.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
