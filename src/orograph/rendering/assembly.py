"""Rasters larger than memory, assembled on disk: pieces in any order, which GDAL reads as one.

Pieces are small compressed TIFFs beside the result, and a VRT places them; later ones cover earlier ones. GDAL encodes
the result from it, so that nothing is ever uncompressed on disk: TIFFs are cloud-optimised (tiles and overviews), which
takes the pieces, the overviews and the result. Units: pixels.
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.header import copyright_tags, plain_copyright
from orograph.dem.writing import gdal_writes, raster_file, write_cog
from orograph.errors import OutputError
from orograph.geo.grid import Grid
from orograph.output import beside
from orograph.rendering.metadata import stamp, tiff_tags

BLOCK = (512, 32)
"""Columns and rows of a piece's blocks: few rows, because PNG and JPEG are encoded row by row."""

OPTIONS: dict[str, dict[str, Any]] = {
    "PNG": {"ZLEVEL": 4, "WRITE_METADATA_AS_TEXT": "YES"},
    "JPEG": {"QUALITY": 92, "JPEG_QUALITY": 92},
    "WEBP": {"LOSSLESS": "YES"},
}
"""Creation options of GDAL's drivers."""

Raster = NDArray[np.uint8] | NDArray[np.float32]


def piece(raster: Raster) -> bytes:
    """Pixels (rows, cols, 3) uint8 or depths (rows, cols) float32, as a TIFF."""
    from rasterio.io import MemoryFile

    rows, cols, *_ = raster.shape
    bands = raster.transpose(2, 0, 1) if raster.ndim == 3 else raster[None]
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": cols, "height": rows, "count": len(bands), "dtype": raster.dtype.name,
        "interleave": "pixel", "tiled": True, "blockxsize": BLOCK[0], "blockysize": BLOCK[1], "compress": "deflate",
        "zlevel": 1, "predictor": 2 if raster.ndim == 3 else 3,
    }  # fmt: skip
    with gdal_writes(Path("piece.tif")), MemoryFile() as memory:
        with memory.open(**profile) as file:
            file.write(bands)
        return bytes(memory.read())


class Assembly:
    """A raster in pieces on disk.

    Args:
        out: what it becomes. width, height: pixels.
        depth: whether it holds depths, float32, NaN where there are none; otherwise colours, three bytes.
        place: of a plan.
    """

    def __init__(
        self, out: Path, width: int, height: int, *, depth: bool = False, place: Grid | None = None
    ) -> None:  # fmt: skip
        self.out, self.width, self.height, self.depth, self.place = out, width, height, depth, place
        self.folder = beside(out, "raw").absolute()
        self._pieces: list[tuple[Path, int, int, int, int]] = []

    def __enter__(self) -> Assembly:
        try:
            self.folder.mkdir()
        except OSError as error:
            raise OutputError(f"The file cannot be written: {error.strerror}.", path=self.out) from error
        return self

    def write(self, left: int, top: int, raster: Raster) -> None:
        """Add a piece that begins at (left, top)."""
        path = self.folder / f"{len(self._pieces)}.tif"
        try:
            path.write_bytes(piece(raster))
        except OSError as error:
            raise OutputError(f"The file cannot be written: {error.strerror}.", path=self.out,
                              remedy="Check that the disk has space.") from error  # fmt: skip
        self.refer(path, left, top, raster.shape[1], raster.shape[0])

    def refer(self, path: Path, left: int, top: int, wide: int, tall: int) -> None:
        """Add a piece that lies in a file (of ``piece``'s bytes), which is left there."""
        self._pieces.append((path.absolute(), left, top, wide, tall))

    def read(self, x0: int, y0: int, x1: int, y1: int) -> NDArray[Any]:
        """Pixels [y0, y1) × [x0, x1): (rows, cols, 3)."""
        import rasterio
        from rasterio.windows import Window

        with gdal_writes(self.out), rasterio.open(self.described({})) as file:
            found: NDArray[Any] = file.read(window=Window(x0, y0, x1 - x0, y1 - y0))
        return np.ascontiguousarray(found.transpose(1, 2, 0))

    def described(self, tags: dict[str, Any]) -> Path:
        """The VRT of what has been added, with metadata."""
        from xml.sax.saxutils import escape, quoteattr  # late, for it loads what talks to servers

        kind, count = ("Float32", 1) if self.depth else ("Byte", 3)
        said = "".join(f"<MDI key={quoteattr(name)}>{escape(str(text))}</MDI>" for name, text in tags.items())
        lines = [f'<VRTDataset rasterXSize="{self.width}" rasterYSize="{self.height}">', f"<Metadata>{said}</Metadata>"]
        lines.append('<Metadata domain="IMAGE_STRUCTURE"><MDI key="INTERLEAVE">PIXEL</MDI></Metadata>')
        if self.place is not None:
            if self.place.crs is not None:
                lines.append(f"<SRS>{escape(self.place.crs.to_wkt())}</SRS>")
            lines.append(f"<GeoTransform>{', '.join(map(repr, self.place.transform.to_gdal()))}</GeoTransform>")
        for band in range(1, count + 1):
            lines.append(f'<VRTRasterBand dataType="{kind}" band="{band}">')
            if self.depth:
                lines.append("<Description>view-space depth, metres</Description><NoDataValue>nan</NoDataValue>")
            else:
                lines.append(f"<ColorInterp>{('Red', 'Green', 'Blue')[band - 1]}</ColorInterp>")
            for path, left, top, wide, tall in self._pieces:
                size = f'xSize="{wide}" ySize="{tall}"'
                lines.append(
                    f'<SimpleSource><SourceFilename relativeToVRT="0" shared="0">{escape(str(path))}</SourceFilename>'
                    f'<SourceBand>{band}</SourceBand><SourceProperties RasterXSize="{wide}" RasterYSize="{tall}" '
                    f'DataType="{kind}" BlockXSize="{BLOCK[0]}" BlockYSize="{BLOCK[1]}"/><SrcRect xOff="0" yOff="0" '
                    f'{size}/><DstRect xOff="{left}" yOff="{top}" {size}/></SimpleSource>'
                )
            lines.append("</VRTRasterBand>")
        path = self.folder / "whole.vrt"
        path.write_text("\n".join([*lines, "</VRTDataset>"]), encoding="utf-8")
        return path

    def encode(
        self, kind: str, attribution: tuple[str, ...] = (), dpi: float | None = None, threads: int = 1
    ) -> None:  # fmt: skip
        """Write the result, a few rows at a time.

        Raises:
            OutputError: it cannot be written.
        """
        import rasterio.shutil

        with raster_file(self.out) as part:
            if kind == "TIFF":
                whole = self.described({**copyright_tags(attribution), **tiff_tags(dpi)})
                overviews = "NEAREST" if self.depth else "AVERAGE"  # depths on both sides of an edge have no mean
                write_cog(whole, part, floats=self.depth, overviews=overviews, threads=threads)
                return
            credit = {"Copyright": "; ".join(attribution), "EXIF_Copyright": plain_copyright(attribution)}
            rasterio.shutil.copy(self.described(credit if attribution else {}), part, driver=kind, **OPTIONS[kind])
            stamp(part, kind, attribution, dpi)

    def __exit__(self, *error: object) -> None:
        with suppress(OSError):
            shutil.rmtree(self.folder)
