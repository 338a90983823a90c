"""The errors of images that GDAL fails to read, and of servers that give no tiles."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from orograph.dem.handles import cause_of
from orograph.errors import ReadError


def unreadable(location: str, error: BaseException) -> ReadError:
    """What is said of an image that GDAL fails to read."""
    if location.endswith(".xml") and (why := server_failure(error)):
        return ReadError(
            f"The server did not give a tile: {why}.", path=_service(location),
            remedy="Try again later: what it gave already is kept.",
        )  # fmt: skip
    if location.endswith(".xml") and any("ReadBlockFromFile" in text for text in _messages(error)):
        return ReadError(
            "The server's tiles are no images, or not as wide as expected.", path=_service(location),
            remedy="Tiles have 256 pixels along a side, unless the URL ends in #512 or so.",
        )  # fmt: skip
    return ReadError(
        f"The image cannot be read: {cause_of(error)}", path=location, remedy="Fetch it again if it was cut short."
    )


def _service(location: str) -> str:
    """What the tile service that a file describes is called (``basemaps.DESCRIPTION``)."""
    found = re.search(r"<!-- (.*) -->", Path(location).read_text(encoding="utf-8"))
    return found[1] if found else location


def server_failure(error: BaseException) -> str:
    """What GDAL's tile driver says of a server, "" if it was not at fault."""
    for text in _messages(error):
        if found := re.search(r"HTTP status code: (\d+), error: ([^\n]*)", text):
            return f"status {found[1]}" if found[1] != "0" else found[2].strip().rstrip(".")
    return ""


def _messages(error: BaseException) -> Iterator[str]:
    """What an error and its causes say."""
    inner: BaseException | None = error
    while inner is not None:
        yield str(inner)
        inner = inner.__cause__ or inner.__context__
