"""Heights hidden in the colours of 8-bit pictures ("terrain-RGB" tiles), decoded to metres.

``mapbox``: height = −10000 + 0.1 · (R·65536 + G·256 + B), Mapbox Terrain-RGB v1 (steps of 0.1 m). ``terrarium``: height
= R·256 + G + B/256 − 32768, Mapzen/AWS Terrain Tiles (steps of 1/256 m). A picture does not declare its encoding, which
is never guessed. Where an alpha band is 0, the height is missing.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Encoding = Literal["mapbox", "terrarium"]
ENCODINGS: tuple[str, ...] = get_args(Encoding)


def decode_rgb(bands: NDArray[Any], encoding: str) -> NDArray[np.float32]:
    """Metres, (rows, cols) float32, from ``bands`` (3 or 4, rows, cols) uint8: red, green, blue and perhaps alpha.

    Raises:
        ValueError: for an unknown encoding, or bands that are not three or four of uint8.
    """
    if encoding not in ENCODINGS:
        raise ValueError(f"unknown encoding {encoding!r}; known are {', '.join(ENCODINGS)}")
    if bands.ndim != 3 or bands.shape[0] not in (3, 4) or bands.dtype != np.uint8:
        raise ValueError(f"terrain-RGB needs 3 or 4 bands of uint8, not {bands.shape} of {bands.dtype}")
    red, green, blue = bands[:3].astype(np.float64)
    if encoding == "mapbox":
        heights = -10000 + (red * 65536 + green * 256 + blue) / 10
    else:
        heights = red * 256 + green + blue / 256 - 32768
    result: NDArray[np.float32] = heights.astype(np.float32)
    if bands.shape[0] == 4:
        result[bands[3] == 0] = np.nan
    return result
