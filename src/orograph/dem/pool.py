"""Make GDAL's dataset pool forget the parts of VRTs.

The pool belongs to the process and ends with the last VRT that uses it, but a nested VRT keeps it alive for good. From
then on, a part that could once not be opened is silently 0, even when it is back, and a replaced part keeps its old
content. Filling the pool with as many other parts as it holds makes it forget; these have one sample each, in memory
(about 10 ms).
"""

from __future__ import annotations

import os
import uuid

_PART = (
    "<SimpleSource><SourceFilename>/vsisubfile/0_{size},{name}</SourceFilename><SourceBand>1</SourceBand>"
    '<SourceProperties RasterXSize="1" RasterYSize="1" DataType="Byte" BlockXSize="1" BlockYSize="1"/>'
    '<SrcRect xOff="0" yOff="0" xSize="1" ySize="1"/><DstRect xOff="{col}" yOff="0" xSize="1" ySize="1"/>'
    "</SimpleSource>"
)
_HELD = 100  # GDAL's own default


def is_virtual(location: str) -> bool:
    """Whether GDAL's name of a raster is that of a VRT."""
    return location.lower().endswith(".vrt") or location.startswith("vrt://")


def forget_parts() -> None:
    """Close the parts of VRTs that GDAL holds open, and forget failed ones. Safe from any thread."""
    import rasterio
    from rasterio.io import MemoryFile

    setting = os.environ.get("GDAL_MAX_DATASET_POOL_SIZE", "")
    count = min(max(int(setting), 2), 1000) if setting.isdigit() else _HELD
    with rasterio.Env(), MemoryFile(filename=f"{uuid.uuid4().hex}/part.pgm") as memory:
        memory.write(b"P5\n1 1\n255\n\xff")
        size = len(memory.getbuffer())
        parts = "".join(_PART.format(size=size + col, name=memory.name, col=col) for col in range(count))
        band = f'<VRTRasterBand dataType="Byte" band="1">{parts}</VRTRasterBand>'
        place = "<GeoTransform>0, 1, 0, 1, 0, -1</GeoTransform>"  # (or rasterio warns that there is none)
        with rasterio.open(f'<VRTDataset rasterXSize="{count}" rasterYSize="1">{place}{band}</VRTDataset>') as dataset:
            dataset.read(1)
