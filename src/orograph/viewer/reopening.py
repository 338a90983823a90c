"""A renderer on a new device, made by a thread when the device was lost, while the window goes on.

Opening a device takes a twentieth of a second, a renderer and its shaders half a second and more: no frame has that.
First comes the device, with which panels can be drawn again, then the renderer.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device, open_device
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.viewer.drawing import Drawer


class Coming:
    """What stands for the renderer until there is a new one.

    Args:
        adapter: a part of the GPU's name. make: makes the renderer. prepare: makes it ready for its first frame.
        told: called, from the thread, whenever an attribute has changed.

    Attributes:
        device: the new device, None before it is open. renderer: the new renderer, None before it is ready.
        error: why there is neither, or None.
    """

    busy, resting = True, False

    def __init__(
        self, adapter: str | None, terrain: Terrain, make: Callable[[Device, Terrain], Drawer],
        prepare: Callable[[Any], None], told: Callable[[], None],
    ) -> None:  # fmt: skip
        self.device: Device | None = None
        self.renderer: Drawer | None = None
        self.error: Exception | None = None
        self._what = adapter, terrain, make, prepare
        self._told = told
        self._lock = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="reopen", daemon=True)
        self._thread.start()

    def draw(self, *args: Any, **kwargs: Any) -> Any:
        """There is nothing to draw with yet."""
        raise RuntimeError("The GPU was lost, and the new device is not ready yet.")

    def depth(self) -> NDArray[np.float32]:
        """There is no frame."""
        raise RuntimeError("lost: a new device is being opened")

    def close(self) -> None:
        """Have what is made let go of."""
        with self._lock:
            self._closed = True
            if self.renderer is not None:
                self.renderer.close()

    def join(self) -> None:
        """Return when the thread has ended."""
        self._thread.join()

    def _work(self) -> None:
        adapter, terrain, make, prepare = self._what
        try:
            self.device = open_device(adapter)
            self._told()
            renderer = make(self.device, terrain)
            with contextlib.suppress(Exception):  # the frame says what is wrong
                prepare(renderer)
            with self._lock:
                self.renderer = renderer
                if self._closed:
                    renderer.close()
        except Exception as error:
            self.error = error
        self._told()
