"""Containers that record their own extent: databases (GeoPackage, MBTiles) and HDF5.

GDAL gives 0 for a tile that its database cannot find, and the HDF5 library ignores extra bytes.

Sources: SQLite's file format, section 1.3; HDF5 File Format Specification, section II.A (superblock).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from orograph.dem.whole.png import bytes_fault
from orograph.dem.whole.tiff import tile_fault

if TYPE_CHECKING:
    import sqlite3

_HDF5 = b"\x89HDF\r\n\x1a\n"
_LARGEST = 1 << 30
"""Bytes of a database up to which all its pages are checked."""


def database(dataset: Any, path: str) -> str | None:
    """The fault of a database of tiles, as a sentence; None if there is none."""
    import sqlite3

    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or head[:15] != b"SQLite format 3":
        return "It is not a database."
    page = struct.unpack_from(">H", head, 16)[0]
    (pages,) = struct.unpack_from(">I", head, 28)
    wanted = (65536 if page == 1 else page) * pages
    current = head[24:28] == head[92:96]  # otherwise an old writer did not count its pages
    if Path(f"{path}-wal").exists():
        current = False
    if current and size < wanted:
        return f"It ends after {size:,} of the {wanted:,} bytes that its header promises."
    if size > _LARGEST:
        return None
    try:
        connection = sqlite3.connect(f"file:{quote(str(Path(path).absolute()))}?mode=ro&immutable=1", uri=True)
        try:
            result = [str(row[0]) for row in connection.execute("PRAGMA integrity_check(1)")]
            lost = None if result != ["ok"] else _lost_tile(connection)
        finally:
            connection.close()
    except sqlite3.Error as error:
        return f"Its database is damaged ({error})."
    if result != ["ok"]:
        return f"Its database is damaged ({' '.join(result[0].split())})."
    return lost


def _lost_tile(connection: sqlite3.Connection) -> str | None:
    """A tile that does not decode, for which GDAL gives 0."""
    tables = [str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    for table in tables:
        quoted = table.replace('"', '""')
        columns = {str(row[1]) for row in connection.execute(f'PRAGMA table_info("{quoted}")')}
        if not {"zoom_level", "tile_column", "tile_row", "tile_data"} <= columns:
            continue
        query = f'SELECT zoom_level, tile_column, tile_row, tile_data FROM "{quoted}"'
        for zoom, col, row, data in connection.execute(query):
            whole = isinstance(data, bytes) and (
                bytes_fault(data) is None if data[:4] == b"\x89PNG"
                else tile_fault(data) is None if data[:2] in (b"II", b"MM")
                else data[:3] == b"\xff\xd8\xff" or data[:4] == b"RIFF" or data[:2] == b"\x1f\x8b"
            )  # fmt: skip
            if not whole:
                return f"Its tile {zoom}/{col}/{row} cannot be decoded, and would be read as 0."
    return None


def hdf5(dataset: Any, path: str) -> str | None:
    """The fault in the length of an HDF5 file, as a sentence; None if there is none or it is another format."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        head = file.read(96)
        if head[:8] != _HDF5:
            return None
        wide = head[13] if head[8] < 2 else head[9]
        if wide != 8 or head[8] > 3:
            return None
        base, end = struct.unpack_from("<Q8xQ", head, (24 if head[8] == 0 else 28) if head[8] < 2 else 12)
        if head[8] < 2:
            base, _, end = struct.unpack_from("<QQQ", head, 24 if head[8] == 0 else 28)
        if base:
            return None
        if size < end:
            return f"It ends after {size:,} of the {end:,} bytes that its header promises."
        file.seek(max(end, size - 65536))
        if any(file.read()):
            return f"It has {size:,} bytes where its header promises {end:,}: one of the two is damaged."
    return None
