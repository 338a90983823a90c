"""Make a renderer on a new device in a thread after the device was lost, while the window keeps running.

Opening a device takes a twentieth of a second, a renderer with its shaders half a second or more: too long for a frame.
The device comes first, so that panels can be drawn again, then the renderer.
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
    """Stands in for the renderer until there is a new one.

    Args:
        adapter: a part of the GPU's name. make: makes the renderer. prepare: prepares it for its first frame.
        changed: called from the thread whenever an attribute has changed.

    Attributes:
        device: the new device; None until it is open. renderer: the new renderer; None until it is ready.
        error: the failure, or None.
    """

    busy, resting = True, False

    def __init__(
        self, adapter: str | None, terrain: Terrain, make: Callable[[Device, Terrain], Drawer],
        prepare: Callable[[Any], None], changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self.device: Device | None = None
        self.renderer: Drawer | None = None
        self.error: Exception | None = None
        self._what = adapter, terrain, make, prepare
        self._changed = changed
        self._lock = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="reopen", daemon=True)
        self._thread.start()

    def draw(self, *args: Any, **kwargs: Any) -> Any:
        """Refuse to draw: there is no renderer yet."""
        raise RuntimeError("The GPU was lost, and the new device is not ready yet.")

    def depth(self) -> NDArray[np.float32]:
        """Refuse: there is no frame."""
        raise RuntimeError("lost: a new device is being opened")

    def close(self) -> None:
        """Release the results once they are made."""
        with self._lock:
            self._closed = True
            if self.renderer is not None:
                self.renderer.close()

    def join(self) -> None:
        """Wait for the thread."""
        self._thread.join()

    def _work(self) -> None:
        adapter, terrain, make, prepare = self._what
        try:
            self.device = open_device(adapter)
            self._changed()
            renderer = make(self.device, terrain)
            with contextlib.suppress(Exception):  # the frame reports what is wrong
                prepare(renderer)
            with self._lock:
                self.renderer = renderer
                if self._closed:
                    renderer.close()
        except Exception as error:
            self.error = error
        self._changed()
