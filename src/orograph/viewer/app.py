"""The desktop window: a glfw canvas, a renderer, the loop, and the errors when there is no screen."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import re
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph.errors import OrographError
from orograph.gpu.device import Device, NoAdapterError
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.viewer.drawing import Drawer
    from orograph.viewer.session import Session
    from orograph.viewer.window import Window

MOST_FRAMES = 120.0
"""Maximum frames per second."""
SWITCH = 0.0005
"""Seconds after which a thread that reads tiles yields the interpreter to a waiting frame, which would otherwise lose
the usual 5 ms several times."""
POLL = 0.03
"""Seconds between two polls of mouse and keyboard before the first frame."""
_GARBAGE = gc.get_threshold()


class NoWindowError(OrographError):
    """No window can be opened: there is no screen, or a library is missing."""

    exit_code = 6


def check() -> None:
    """Raise NoWindowError before any work if no window can be opened; NoAdapterError without wgpu."""
    for module in ("wgpu", "rendercanvas", "glfw", "imgui_bundle"):
        try:
            __import__(module)
        except ImportError as error:
            raise NoWindowError(
                f"The window needs {module}.",
                remedy="Install it: pip install 'orograph[view]'. orograph doctor lists alternatives.",
            ) from error
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise NoWindowError(
            "There is no screen to open a window on: neither DISPLAY nor WAYLAND_DISPLAY is set.",
            remedy="Draw pictures with orograph render, or see orograph doctor.",
        )
    import glfw

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if not glfw.init():  # a canvas would abort the process
            why = re.sub(r"^\(\d+\) b'(.*)'$", r"\1", str(said[-1].message)) if said else "it does not answer"
            raise NoWindowError(
                f"The screen cannot be used: {why}.",
                remedy="Draw pictures with orograph render, or see orograph doctor.",
            )


class Warm:
    """Load what the window needs, in a thread, while the terrain is read.

    Nearly all of a start is Python work in one thread or the other; only the GPU's driver runs in parallel. So the GPU
    is opened first, then modules are loaded, then Numba is set up (a quarter of a second before its first kernel).
    """

    def __init__(self, adapter: str | None = None) -> None:
        self._adapter = adapter
        self._opened = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="warm", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        from orograph.gpu.device import open_device

        try:
            open_device(self._adapter)
        except BaseException as error:
            self._failure = error
            return
        finally:
            self._opened.set()
        with contextlib.suppress(Exception):  # the code that needs it reports the error
            importlib.import_module("orograph.viewer.window")
            importlib.import_module("orograph.rendering.gpu.renderer")
            importlib.import_module("orograph.rendering.gpu.stream.tiles").warm()

    def device(self) -> None:
        """Wait for the device.

        Raises:
            NoAdapterError: there is none.
        """
        self._opened.wait()
        if self._failure is not None:
            raise self._failure

    def join(self) -> None:
        """Wait until everything is loaded."""
        self._thread.join()


def hurry() -> None:
    """Collect garbage rarely while modules are loaded: it takes a sixth of a start and finds nothing."""
    gc.set_threshold(100_000, 10, 10)


def settle() -> None:
    """Collect garbage normally from now on, but skip what is already loaded."""
    gc.freeze()
    gc.set_threshold(*_GARBAGE)


def make_canvas(title: str, size: tuple[int, int]) -> Any:
    """A glfw window.

    Raises:
        NoWindowError: the screen does not provide one.
    """
    import glfw
    from rendercanvas.glfw import RenderCanvas

    try:
        return RenderCanvas(
            size=size, title=title, update_mode="ondemand", max_fps=MOST_FRAMES, vsync=True
        )  # fmt: skip
    except (glfw.GLFWError, RuntimeError, TypeError, ValueError) as error:
        raise NoWindowError(
            f"The screen does not provide a window: {error}.", remedy="See orograph doctor, or use orograph render."
        ) from error


def clipboard() -> tuple[Callable[[], str], Callable[[str], None]]:
    """The screen's clipboard."""
    import glfw

    any_window: Any = None  # the argument is unused since GLFW 3.3

    def get() -> str:
        found: Any = glfw.get_clipboard_string(any_window)
        return found.decode("utf-8", "replace") if found else ""

    return get, lambda text: glfw.set_clipboard_string(any_window, text)


def accept_files(canvas: Any, window: Window) -> None:
    """Lay files dropped on a glfw window over the ground."""
    handle = getattr(canvas, "_window", None)
    if handle is None:
        return
    import glfw

    from orograph.viewer.panels.layers import add

    def dropped(_: Any, paths: list[str]) -> None:
        for path in paths:
            if add(window, path):
                window.session.messages.say(f"{Path(path).name} now lies on the ground, above the other layers.")
        window.touch()

    set_callback: Any = glfw.set_drop_callback  # its stub has the C function's signature
    set_callback(handle, dropped)


def renderer_of(
    gpu_memory: int | None = None, memory: int | None = None, jobs: int | None = None
) -> Callable[[Device, Terrain], Drawer]:
    """Makes the renderer of a window."""

    def make(device: Device, terrain: Terrain) -> Drawer:
        from orograph.rendering.gpu.detail_renderer import DetailRenderer
        from orograph.rendering.gpu.renderer import Renderer

        budget = {k: v for k, v in (("gpu_memory", gpu_memory), ("memory", memory)) if v is not None}
        return DetailRenderer(device, terrain, lambda ground: Renderer(device, ground, jobs=jobs, **budget))

    return make


def show(
    session: Session,
    *,
    size: tuple[int, int] = (1280, 800),
    make: Callable[[Device, Terrain], Drawer] | None = None,
    adapter: str | None = None,
    screenshot: Path | None = None,
    frames: int = 1,
    warm: Warm | None = None,
    progress: Progress = SILENT,
) -> None:
    """Open a window for a session, and return when it is closed.

    Args:
        size: of the window, logical pixels.
        make: makes the renderer.
        adapter: a part of the GPU's name.
        screenshot: write the window's terrain there after ``frames`` frames (or once it no longer improves), then
            close.
        warm: the loader of the window's modules.
        progress: gets progress reports until the window opens.

    Raises:
        NoWindowError, NoAdapterError: there is no screen, or no GPU.
        OutputError: the screenshot cannot be written.
    """
    check()
    from rendercanvas.glfw import loop

    from orograph.gpu.device import open_device
    from orograph.viewer.opening import announce, open_canvas

    with progress.task("Opening the window"):
        device = open_device(adapter)
        canvas = make_canvas(f"{session.terrain.name} — Orograph", size)
        try:
            opened = open_canvas(canvas, device, clipboard())
            announce(canvas, device, opened, f"Opening {session.terrain.name} …")
            again = make or renderer_of()
            first = _prepared(session, canvas, again, device, opened[2], warm)
            if canvas.get_closed():
                return
            from orograph.viewer.window import Window

            window = Window(
                session, canvas, lambda d, terrain: first.pop() if first else again(d, terrain), device=device,
                clipboard=clipboard(), adapter=adapter, opened=opened,
            )  # fmt: skip
            accept_files(canvas, window)
        except Exception as error:
            canvas.close()
            if isinstance(error, OrographError):
                raise
            raise NoAdapterError(
                f"{device.adapter.name} cannot draw to this window: {error}.", remedy="See orograph doctor."
            ) from error
    failure: list[BaseException] = []
    if screenshot is not None:
        _shoot(window, screenshot, frames, failure)
    settle()
    sys.setswitchinterval(SWITCH)
    loop.run()
    if failure:
        raise failure[0]


def _prepared(
    session: Session, canvas: Any, make: Callable[[Device, Terrain], Drawer], device: Device, format: str,
    warm: Warm | None,
) -> list[Drawer]:  # fmt: skip
    """The renderer, prepared for the first frame in a thread; meanwhile the window responds and may be closed.

    Args:
        format: of the picture. warm: what loads the window's modules.
    """
    made: list[Drawer] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            if warm is not None:
                warm.join()
            renderer = make(device, session.terrain)
            if hasattr(renderer, "prepare"):
                renderer.prepare(format, session.scene(), overlay=session.settings.overlay())
            made.append(renderer)
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=work, name="prepare", daemon=True)
    thread.start()
    while thread.is_alive() and not canvas.get_closed():
        canvas._process_events()
        thread.join(POLL)
    if failure:
        raise failure[0]
    return made


def _shoot(window: Window, path: Path, frames: int, failure: list[BaseException]) -> None:
    """Save a picture after ``frames`` frames, or when further ones would be the same, and close."""

    def hook(w: Window) -> None:
        enough = w.drawing.drawn >= frames or w.drawing.done  # no frames are drawn at rest
        if enough and not w.plan.wanted and not failure:
            w.on_frame.remove(hook)
            try:
                w.pictures.write(path, panels=True)
            except BaseException as error:
                failure.append(error)
            w.canvas.close()
        else:
            w.refresh()

    window.on_frame.append(hook)
