"""The window in a notebook's cell: ``orograph.view(terrain)``.

The same panels, mouse and keys on ``rendercanvas``'s widget, which runs in Jupyter, VS Code, Colab and marimo. The cell
also holds a still picture of the first view. It appears where no front end runs the widget (a notebook on a web page, a
printed one), and replaces the widget if the extra ``notebook`` or a GPU is missing; then the CPU draws it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack, cast

from orograph._named import answering
from orograph.cards import png
from orograph.errors import OrographError
from orograph.folders import Amount, bytes_of
from orograph.progress import SILENT, Progress
from orograph.rendering.picture import Picture
from orograph.scene.methods import check_promise, conservative_method
from orograph.scene.scene import Scene
from orograph.scene.sizes import Size, size_of
from orograph.scene.typed import SceneOptions
from orograph.store.given import READING
from orograph.store.opening import terrain as opened
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.viewer.traits import Widget

SIZE = (900, 560)


@dataclass(slots=True, repr=False)
class Still:
    """A picture instead of a widget.

    Attributes:
        picture: the picture. why: a sentence that says why the widget cannot run, or "".
    """

    picture: Picture
    why: str = ""

    def __repr__(self) -> str:
        return f"<Still {self.picture.view.width} × {self.picture.view.height}{': ' + self.why if self.why else ''}>"

    def _repr_png_(self) -> bytes:
        return png(self.picture.pixels)


@answering
def view(
    terrain: Any,
    camera: View | None = None,
    *,
    size: Size = SIZE,
    panels: bool = False,
    gpu_memory: Amount = 256 << 20,
    conservative: bool = False,
    progress: Progress | bool | None = None,
    **options: Unpack[SceneOptions],
) -> Widget | Still:
    """Explore a terrain in a cell; a still picture if that is impossible.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options.
        camera: the first view; None: all of it, from the south.
        size: of the cell's picture, pixels.
        panels: whether panels are shown initially (Tab toggles them).
        gpu_memory: bytes of GPU memory for tiles.
        conservative: as of ``render``.
        progress: gets progress reports on reading the terrain; False: silent.
        options: of the scene, as for ``orograph.render`` (sun, exaggeration, layers…).

    Raises:
        UsageError: an option makes no sense. NothingInViewError: the terrain has no valid sample.
    """
    from orograph.viewer.session import Session

    size, gpu_memory = size_of(size), bytes_of(gpu_memory, "gpu_memory")
    chosen = cast("dict[str, Any]", options)
    reading = {name: chosen.pop(name) for name in READING if name in chosen}
    if conservative:
        chosen["method"] = conservative_method(chosen.get("method", "auto"), "gpu")
    terrain = opened(terrain, progress, called="view", **reading)
    if conservative:
        check_promise(chosen["method"], "gpu", terrain)
    session = Session(terrain, camera, size=size, **chosen)
    session.settings.panels = panels
    scene = session.scene()
    try:
        import rendercanvas.anywidget  # noqa: F401

        from orograph.viewer.app import renderer_of
        from orograph.viewer.cell import Clipboard, make_canvas
        from orograph.viewer.traits import Widget
        from orograph.viewer.window import Window
    except ImportError as error:
        session.close()
        return Still(_cpu(scene), f"the widget needs {error.name}: pip install 'orograph[notebook]'")
    try:
        from orograph.gpu.device import open_device
        from orograph.rendering.gpu.detail_renderer import DetailRenderer
        from orograph.rendering.gpu.draw import draw

        device = open_device()
        again = renderer_of(gpu_memory)
        made = again(device, terrain)
        assert isinstance(made, DetailRenderer)
        still, first = draw(scene, SILENT, device=device, renderer=made.plain), [made]
        canvas = make_canvas(size, title="", update_mode="ondemand", max_fps=30)
        clipboard = Clipboard(canvas)
        window = Window(
            session, canvas, lambda d, t: first.pop() if first else again(d, t), device=device,
            clipboard=(clipboard.get, clipboard.put),
        )  # fmt: skip
    except OrographError as error:
        session.close()
        return Still(_cpu(scene), str(error))
    return Widget(window, canvas, png(still.pixels))


def _cpu(scene: Scene) -> Picture:
    from orograph.rendering.cpu.draw import draw

    return draw(scene)
