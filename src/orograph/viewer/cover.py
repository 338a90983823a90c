"""How much of a terrain its layers hide: the colour bar of heights is only useful while their colours are visible.

Places spread evenly over the terrain are looked up in each layer's image, by its extent alone, once, in a thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import HANDLES, locate
from orograph.errors import OrographError
from orograph.geo.grid import Grid
from orograph.geovis.layers import Layer
from orograph.geovis.placement import Placement, grid_of

if TYPE_CHECKING:
    from orograph.viewer.probe import Probe
    from orograph.viewer.session import Session

SIDE = 48
"""Maximum places along each side of the terrain."""
MOST = 0.97
"""If layers hide more of the ground than this part, its colours no longer count."""


def places(probe: Probe) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places with ground, evenly spread: coordinates in the terrain's CRS, (n,) and (n,)."""
    rows, cols = (np.unique(np.linspace(0, n - 1, SIDE).round().astype(int)) for n in probe.coarse.shape)
    r, c = (axis.ravel() for axis in np.meshgrid(rows, cols, indexing="ij"))
    there = np.isfinite(probe.coarse[r, c])
    scale = 2.0**probe.level
    return probe.terrain.grid.xy(c[there] * scale, r[there] * scale)


def inside(path: str, grid: Grid, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which places, in the CRS of the terrain's ``grid``, lie in the image of a file; none, if it cannot be read."""
    try:
        location = locate(path)
        with HANDLES.borrow(location) as file:
            image = grid_of(file)
        u, v = Placement.of(grid, image, path, []).pixels(x, y)
    except (OrographError, OSError):
        return np.zeros(x.shape, bool)
    return np.asarray((u >= 0) & (u <= image.cols) & (v >= 0) & (v <= image.rows))


class Cover:
    """What the layers of a session hide; a layer not yet looked up counts as hiding the ground."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._places = places(session.probe)
        self._masks: dict[str, NDArray[np.bool_] | None] = {}

    def hides(self) -> bool:
        """Whether the colours of heights are hardly visible."""
        hidden = np.zeros(self._places[0].shape, bool)
        for layer in self._session.settings.layers:
            if layer.hides:
                mask = self._mask(layer)
                if mask is None:
                    return True
                hidden |= mask
        return bool(len(hidden) and hidden.mean() > MOST)

    def _mask(self, layer: Layer) -> NDArray[np.bool_] | None:
        if layer.path not in self._masks:
            self._masks[layer.path] = None
            self._session.probe.submit(lambda: self._find(layer.path))
        return self._masks[layer.path]

    def _find(self, path: str) -> None:
        self._masks[path] = inside(path, self._session.terrain.grid, *self._places)
        self._session.changed()
