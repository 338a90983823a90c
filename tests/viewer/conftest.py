"""A window for tests: in the process, on an off-screen canvas that is told of events; and a real one under Xvfb."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.gpu.device import Device

sys.path.insert(0, str(Path(__file__).parent))

EAST, NORTH, SIDE, CELL = 412_000.0, 4_987_000.0, 257, 30.0
"""Where the test terrain lies: its first sample, samples a side, metres between them."""
PLAIN = 500.0
"""Metres: all of it is level, so that what is under a pixel is known in closed form, but for a hill in the north."""


def heights() -> np.ndarray:
    z = np.full((SIDE, SIDE), PLAIN, np.float32)
    row, col = np.mgrid[:SIDE, :SIDE]
    far = np.hypot(row - 50.0, col - 128.0) / 30.0
    z += np.where(far < 1, 900.0 * (1 - far) ** 2, 0.0).astype(np.float32)
    return z


@pytest.fixture(scope="session")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GeoTIFF of the test terrain."""
    path = tmp_path_factory.mktemp("dem") / "plain.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=SIDE, height=SIDE, count=1, dtype="float32", crs="EPSG:32633",
        transform=Affine(CELL, 0, EAST - CELL / 2, 0, -CELL, NORTH + CELL / 2),
    ) as file:  # fmt: skip
        file.write(heights(), 1)
    return path


@pytest.fixture(autouse=True)
def own_config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test reads or writes the user's own settings."""
    folder = tmp_path / "config"
    monkeypatch.setenv("OROGRAPH_CONFIG", str(folder))
    return folder


def missing(what: str) -> None:
    """Skip a test, or fail it in CI, where everything is installed."""
    if os.environ.get("CI"):
        pytest.fail(f"CI tests the window: {what}")
    pytest.skip(what)


@pytest.fixture(scope="module")
def screen() -> Iterator[str]:
    """The display of a virtual screen of 1400 × 900 pixels."""
    for tool in ("Xvfb", "xdotool"):
        if shutil.which(tool) is None:
            missing(f"{tool} is not installed")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1400x900x24", "-nolisten", "tcp", "-noreset"],
        # (Else it starts anew when the last client leaves, and refuses the next one meanwhile.)
        pass_fds=[write], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    if not number:
        missing("Xvfb does not start")
    yield f":{number}"
    server.terminate()
    server.wait(10)


class Person:
    """Someone before a screen: a mouse, a keyboard, eyes.

    Attributes:
        folder: where the program was started.
    """

    def __init__(self, display: str, command: list[str], folder: Path, config: Path, pause: float = 0.2) -> None:
        self.display, self.folder, self.config = display, folder, config
        self.log = folder / "stderr.txt"
        env = {**os.environ, "DISPLAY": display, "OROGRAPH_CONFIG": str(config), "OROGRAPH_ADAPTER": "software"}
        env.pop("WAYLAND_DISPLAY", None)
        self.program = subprocess.Popen(
            [sys.executable, "-m", "orograph", *command], env=env, cwd=folder, stderr=self.log.open("w")
        )
        self.window = self.wait(self._find, 180, pause)
        if pause < 0.1:  # in a hurry
            return
        self.do("windowfocus", self.window)
        self.wait(self.view, 120)

    def _find(self) -> str | None:
        if self.program.poll() is not None:
            raise AssertionError(f"the program ended:\n{self.log.read_text()}")
        found = self._tool("search", "--name", "Orograph", check=False)
        return found.split()[0] if found else None

    def _tool(self, *words: str, check: bool = True) -> str:
        env = {**os.environ, "DISPLAY": self.display}
        done = subprocess.run(["xdotool", *words], env=env, capture_output=True, text=True, check=check, timeout=30)
        return done.stdout.strip()

    def do(self, *words: str) -> None:
        """Use mouse or keyboard: the words of xdotool."""
        self._tool(*words)

    def drag(self, button: int, *places: tuple[int, int]) -> None:
        """Drag over places, slowly enough for a hand."""
        (x, y), *rest = places
        self.do("mousemove", str(x), str(y))
        time.sleep(0.15)
        self.do("mousedown", str(button))
        time.sleep(0.15)
        for x, y in rest:
            self.do("mousemove", str(x), str(y))
            time.sleep(0.15)
        self.do("mouseup", str(button))
        time.sleep(0.15)

    def view(self) -> dict | None:
        """The camera as the program tells it: kept under 9 with Ctrl + 9, read from the file."""
        import json

        files = list((self.config / "views").glob("*.json"))
        before = files[0].stat().st_mtime_ns if files else 0
        self.do("key", "ctrl+9")
        for _ in range(100):
            files = list((self.config / "views").glob("*.json"))
            if files and files[0].stat().st_mtime_ns > before:
                return json.loads(files[0].read_text())["9"]
            if self.program.poll() is not None:
                raise AssertionError(f"the program ended:\n{self.log.read_text()}")
            time.sleep(0.1)
        return None

    def settled(self, seconds: float = 60) -> dict:
        """The camera when it has come to rest."""
        last = self.view()
        for _ in range(int(seconds)):
            time.sleep(0.4)
            now = self.view()
            if now is not None and now == last:
                return now
            last = now
        raise AssertionError("the camera does not come to rest")

    def see(self) -> np.ndarray:
        """The window (height, width, 3) as it is on the screen."""
        from PIL import ImageGrab

        geometry = dict(
            line.split("=") for line in self._tool("getwindowgeometry", "--shell", self.window).splitlines()
        )
        x, y, w, h = (int(geometry[k]) for k in ("X", "Y", "WIDTH", "HEIGHT"))
        whole = np.asarray(ImageGrab.grab(xdisplay=self.display).convert("RGB"))
        return whole[y : y + h, x : x + w]

    @staticmethod
    def wait(what: Callable, seconds: float, pause: float = 0.2):
        """What ``what`` gives, once it gives something; asked again after a pause."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = what()
            if found is not None and found is not False:
                return found
            time.sleep(pause)
        raise AssertionError(f"waited {seconds} s in vain for {what}")

    def close(self) -> int:
        """Close the window as its frame's button does; the exit code."""
        ask_to_close(self.display, int(self.window))
        return self.program.wait(30)


def ask_to_close(display: str, window: int) -> None:
    """Send WM_DELETE_WINDOW, as a window manager does when its button is pressed (there is none here)."""
    import ctypes

    class Message(ctypes.Structure):
        _fields_ = (
            ("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int),
            ("display", ctypes.c_void_p), ("window", ctypes.c_ulong), ("message_type", ctypes.c_ulong),
            ("format", ctypes.c_int), ("data", ctypes.c_long * 5), ("pad", ctypes.c_long * 12),
        )  # fmt: skip

    x = ctypes.CDLL("libX11.so.6")
    x.XOpenDisplay.restype = ctypes.c_void_p
    x.XInternAtom.restype = ctypes.c_ulong
    handle = ctypes.c_void_p(x.XOpenDisplay(display.encode()))
    atoms = [x.XInternAtom(handle, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")]
    message = Message(33, 0, 1, handle, window, atoms[0], 32, (ctypes.c_long * 5)(atoms[1], 0, 0, 0, 0))
    x.XSendEvent(handle, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(message))
    x.XCloseDisplay(handle)


@pytest.fixture
def person(screen: str, device: Device, dem: Path, tmp_path: Path, own_config: Path) -> Iterator[Callable[..., Person]]:
    """Starts ``orograph view`` on the test terrain, or on what it is given."""
    begun: list[Person] = []

    def start(*words: str, pause: float = 0.2) -> Person:
        command = ["view", *(words or [str(dem)]), "--size", "1200x800"]
        begun.append(Person(screen, command, tmp_path, own_config, pause))
        return begun[-1]

    yield start
    for someone in begun:
        if someone.program.poll() is None:
            someone.program.kill()
            someone.program.wait(10)


@pytest.fixture
def window(device: Device, dem: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A window on the test terrain, on an off-screen canvas."""
    pytest.importorskip("imgui_bundle")
    from rendercanvas.offscreen import RenderCanvas

    from orograph.store.prepare import prepare
    from orograph.viewer.app import renderer_of
    from orograph.viewer.session import Session
    from orograph.viewer.window import Window

    monkeypatch.setattr("orograph.viewer.session.SHOWN", 600.0)  # a slow machine may take longer than a message stays
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    canvas = RenderCanvas(size=(900, 600))
    kept: list[str] = [""]
    window = Window(
        session,
        canvas,
        renderer_of(64 << 20),
        device=device,
        clipboard=(lambda: kept[0], lambda t: kept.__setitem__(0, t)),
    )
    yield window
    canvas.close()
    window.gui.close()


@pytest.fixture
def hand(window: Any) -> Any:
    """A hand on it."""
    from hand import Hand

    hand = Hand(window)
    hand.frames(3)
    return hand


@pytest.fixture
def front_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """``rendercanvas.anywidget`` as it looks from here, drawing off screen."""
    from rendercanvas.offscreen import OffscreenRenderCanvas

    class Canvas(OffscreenRenderCanvas):
        def _repr_mimebundle_(self, **options: Any) -> Any:
            return {"application/vnd.jupyter.widget-view+json": {"model_id": "0"}}, {}

    module = types.ModuleType("rendercanvas.anywidget")
    module.RenderCanvas = Canvas
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", module)
