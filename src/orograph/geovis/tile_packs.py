"""Local tiles as MBTiles, which GDAL reads: folders of {z}/{x}/{y} files, and PMTiles.

The copy is kept in the cache folder under a name made of what it was made of; it appears whole. In MBTiles (version
1.3) rows are counted from the south.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import closing
from hashlib import sha256
from pathlib import Path

from orograph.errors import ReadError, UsageError
from orograph.folders import cache_folder
from orograph.output import Beside
from orograph.store.kept import IMAGES, Use

Tile = tuple[int, int, int, bytes]
"""Zoom, column, row from the north, and the encoded picture."""

_used: dict[Path, Use] = {}


def of_folder(pattern: str, *, bottom: bool = False) -> Path:
    """The MBTiles of a folder of tiles.

    Args:
        pattern: "FOLDER/{z}/{x}/{y}.png", with any file names in between. bottom: rows are counted from the south.

    Raises:
        ReadError: there are no tiles.
    """
    files = sorted(_files(pattern))
    if not files:
        raise ReadError("There are no tiles.", path=pattern, remedy="Give them as FOLDER/{z}/{x}/{y}.png.")
    newest = max(path.stat().st_mtime_ns for *_, path in files)
    out = kept_folder(Path(pattern).parts[-4] if len(Path(pattern).parts) > 3 else "tiles", pattern, bottom,
                      len(files), newest) / "tiles.mbtiles"  # fmt: skip
    if not out.exists():
        _write(out, ((z, x, (1 << z) - 1 - y if bottom else y, path.read_bytes()) for z, x, y, path in files))
    return out


def of_pmtiles(path: Path) -> Path:
    """The MBTiles of a PMTiles archive of pictures.

    Raises:
        ReadError: it is missing, damaged, or of vectors. UsageError: the package that reads it is not installed.
    """
    try:
        from pmtiles.reader import MmapSource, Reader, all_tiles
        from pmtiles.tile import TileType
    except ImportError:
        raise UsageError("Reading PMTiles needs the package pmtiles, which is not installed.", path=path,
                         remedy="pip install pmtiles") from None  # fmt: skip
    try:
        stat = path.stat()
        out = kept_folder(path.stem, str(path.absolute()), stat.st_size, stat.st_mtime_ns) / "tiles.mbtiles"
        if out.exists():
            return out
        with path.open("rb") as file:
            source = MmapSource(file)  # type: ignore[no-untyped-call]
            kind = Reader(source).header()["tile_type"]  # type: ignore[no-untyped-call]
            if kind in (TileType.MVT, TileType.UNKNOWN):
                raise ReadError(
                    "Its tiles are not pictures.", path=path, remedy="Name PMTiles that hold PNG, JPEG or WebP."
                )
            _write(out, ((*zxy, data) for zxy, data in all_tiles(source)))  # type: ignore[no-untyped-call]
    except OSError as error:
        raise ReadError(f"It cannot be read: {error.strerror}.", path=path) from error
    except (ValueError, KeyError, IndexError, EOFError) as error:
        raise ReadError(f"It is damaged: {error}.", path=path, remedy="Fetch it again.") from error
    return out


def _files(pattern: str) -> Iterator[tuple[int, int, int, Path]]:
    """Zoom, column, row and path of the files that a pattern names."""
    root = Path(pattern[: pattern.index("{")].rpartition("/")[0] or ".")
    shape = re.escape(pattern)
    for part in "zxy":
        shape = shape.replace(re.escape(f"{{{part}}}"), rf"(?P<{part}>\d+)")
    for path in root.rglob("*"):
        found = re.fullmatch(shape, path.as_posix())
        if found and path.is_file():
            yield int(found["z"]), int(found["x"]), int(found["y"]), path


def _write(out: Path, tiles: Iterable[Tile]) -> None:
    """Write MBTiles, whole or not at all."""
    import sqlite3  # late, for only this needs it

    with Beside(out) as part, closing(sqlite3.connect(part)) as base:
        base.execute("CREATE TABLE metadata (name text, value text)")
        base.execute("CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)")
        zooms: set[int] = set()
        first = b""
        for z, x, y, data in tiles:
            zooms.add(z)
            first = first or data
            base.execute("INSERT INTO tiles VALUES (?, ?, ?, ?)", (z, x, (1 << z) - 1 - y, data))
        base.execute("CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row)")
        said = {
            "name": out.parent.name, "type": "baselayer", "version": "1", "format": _format(first),
            "minzoom": min(zooms, default=0), "maxzoom": max(zooms, default=0),
            "bounds": "-180,-85.051129,180,85.051129",
        }  # fmt: skip
        base.executemany("INSERT INTO metadata VALUES (?, ?)", [(k, str(v)) for k, v in said.items()])
        base.commit()


def _format(data: bytes) -> str:
    """The format of an encoded picture."""
    if data.startswith(b"\xff\xd8"):
        return "jpg"
    return "webp" if data[8:12] == b"WEBP" else "png"


def kept_folder(name: str, *said: object) -> Path:
    """A folder of the cache for a map; it stays while this process lives."""
    plain = re.sub(r"[^\w.-]+", "-", name)[:40]
    folder = cache_folder() / IMAGES / f"{plain}-{sha256(repr(said).encode()).hexdigest()[:12]}"
    folder.mkdir(parents=True, exist_ok=True)
    if folder not in _used:
        _used[folder] = Use(folder)
    return folder
