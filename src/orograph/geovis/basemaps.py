"""Maps and imagery of tile services as layers: ``xyz:NAME`` of the xyzservices catalogue, or ``xyz:URL`` with {z}, {x}
and {y}; local folders of tiles (``xyz:FOLDER/{z}/{x}/{y}.png``), MBTiles and PMTiles.

GDAL reads a service as one image in Web Mercator whose overviews are the zoom levels, so that a picture asks for the
tiles of the zoom that its pixels need. Its description and the tiles that were read are kept in the cache folder for
``FRESH`` seconds at least; the folder is one of the images that make room for others (``store.kept``). Folders and
PMTiles become an MBTiles file there. Tiles that a server does not have (404) are transparent.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from html import escape
from pathlib import Path

from orograph.errors import UsageError
from orograph.geovis.tile_packs import kept_folder, of_folder, of_pmtiles
from orograph.output import Beside

PREFIX = "xyz:"
FRESH = 7 * 86400
"""Seconds for which a tile that was read is not requested again."""
WORLD = 20037508.342789244
"""Metres from the middle of Web Mercator to its border."""
FINEST = 18
"""Finest zoom of a service that does not declare one."""
SIDE = 256
"""Pixels along a side of a tile, likewise."""
PATIENCE, CONNECTIONS = 15, 4
"""Seconds to wait for an answer; simultaneous requests for tiles."""

DESCRIPTION = """<GDAL_WMS>
  <!-- {called} -->
  <Service name="TMS"><ServerUrl>{url}</ServerUrl></Service>
  <DataWindow>
    <UpperLeftX>-{world}</UpperLeftX><UpperLeftY>{world}</UpperLeftY>
    <LowerRightX>{world}</LowerRightX><LowerRightY>-{world}</LowerRightY>
    <TileLevel>{finest}</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY><YOrigin>{origin}</YOrigin>
  </DataWindow>
  <Projection>EPSG:3857</Projection>
  <BlockSizeX>{side}</BlockSizeX><BlockSizeY>{side}</BlockSizeY><BandsCount>4</BandsCount>
  <OverviewCount>{levels}</OverviewCount>
  <UserAgent>{agent}</UserAgent><ZeroBlockHttpCodes>204,404</ZeroBlockHttpCodes>
  <Timeout>{patience}</Timeout><MaxConnections>{connections}</MaxConnections>
  <Cache><Path>{cache}</Path><Expires>{fresh}</Expires></Cache>
</GDAL_WMS>
"""


@dataclass(frozen=True, slots=True)
class Basemap:
    """A tile service.

    Attributes:
        name: its name. url: with {z}, {x} and {y}. attribution: the credit that it asks for.
        coarsest, finest: its zoom levels. side: pixels of a tile. bottom: whether rows are counted from the south.
    """

    name: str
    url: str
    attribution: str = ""
    coarsest: int = 0
    finest: int = FINEST
    side: int = SIDE
    bottom: bool = False

    @classmethod
    def of(cls, text: str) -> Basemap:
        """The service of ``xyz:NAME`` or ``xyz:URL``; ``?key=value&…`` after a name supplies the service's parameters,
        ``#512`` after a URL says how many pixels wide its tiles are.

        Raises:
            UsageError: there is no such service, or it needs a token.
        """
        what = text.removeprefix(PREFIX)
        if "{" in what:
            what, side = _sized(what)
            lacking = [part for part in ("{z}", "{x}") if part not in what]
            if lacking or not ("{y}" in what or "{-y}" in what):
                raise UsageError(f"A URL of tiles must have {{z}}, {{x}} and {{y}}: {what}.")
            name = re.sub(r"^\w+://(www\.)?", "", what).partition("/")[0] if "://" in what else Path(what).parts[0]
            return cls(name, what.replace("{-y}", "{y}"), side=side, bottom="{-y}" in what)
        name, _, said = what.partition("?")
        return _of_catalogue(name, dict(part.partition("=")[::2] for part in said.split("&") if part))

    def description(self, cache: Path) -> str:
        """The description for GDAL."""
        from orograph.fetching.asking import user_agent

        url = self.url.replace("{z}", "${z}").replace("{x}", "${x}").replace("{y}", "${y}")
        return DESCRIPTION.format(
            called=f"{PREFIX}{self.name}".replace("--", "-"), url=escape(url, False), world=WORLD, finest=self.finest,
            origin="bottom" if self.bottom else "top", side=self.side,
            levels=self.finest - self.coarsest, agent=escape(user_agent(), False), patience=PATIENCE,
            connections=CONNECTIONS, cache=escape(str(cache), False), fresh=FRESH,
        )  # fmt: skip


def location_of(path: str) -> str:
    """The file of a service or of packed tiles for GDAL; any other path unchanged."""
    if path.startswith(PREFIX):
        found = Basemap.of(path)
        if "://" not in found.url:
            return str(of_folder(found.url, bottom=found.bottom))
        return str(_described(found))
    if "{z}" in path and "{x}" in path:
        raise UsageError("This is the pattern of a tile service's names.", path=path, remedy=f"Write {PREFIX}{path}.")
    if path.lower().endswith(".pmtiles") and "://" not in path:
        return str(of_pmtiles(Path(path)))
    return path


def _sized(url: str) -> tuple[str, int]:
    """A URL and the pixels along a side of its tiles: 512 after ``#512``, and of tiles for fine screens (``@2x``)."""
    url, hash_, side = url.partition("#")
    if hash_ and not (side.isdigit() and 16 <= int(side) <= 4096):
        raise UsageError(f"After # comes the width of a tile in pixels, such as #512, not {side!r}.")
    return url, int(side) if hash_ else 512 if "@2x" in url else SIDE


def _described(found: Basemap) -> Path:
    """The file that describes a service, beside the tiles that were read of it."""
    folder = kept_folder(found.name, found.url)
    text, path = found.description(folder / "tiles"), folder / "map.xml"
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        with Beside(path) as part:
            part.write_text(text, encoding="utf-8")
    return path


def _of_catalogue(name: str, said: dict[str, str]) -> Basemap:
    """A service of the xyzservices catalogue."""
    import difflib

    from xyzservices import providers

    every = providers.flatten()
    try:
        found = providers.query_name(name)
    except ValueError:
        close = difflib.get_close_matches(name, every, 3, 0.5)
        remedy = f"Did you mean {' or '.join(close)}?" if close else "See https://xyzservices.readthedocs.io."
        if Path(name).is_dir():
            remedy = f"For a folder of tiles write {PREFIX}{name}/{{z}}/{{x}}/{{y}}.png."
        raise UsageError(f"There is no tile service {name!r}.", remedy=remedy) from None
    found = found.copy()
    unknown = sorted(set(said) - set(found))
    if unknown:
        raise UsageError(f"{found.name} has no parameter {unknown[0]!r}.")
    found.update(said)
    if found.requires_token():
        wanted = next((key for key, value in found.items() if "<insert" in str(value)), "token")
        raise UsageError(
            f"{found.name} needs a token of yours.", remedy=f"Add it after the name: xyz:{found.name}?{wanted}=…"
        )
    if str(found.get("crs", "EPSG:3857")) != "EPSG:3857":
        raise UsageError(f"{found.name} is in {found['crs']}; only Web Mercator can be read.")
    template = {key: f"{{{key}}}" for key in ("x", "y", "z")}
    url = found.build_url(**template) if "{-y}" not in found["url"] else found["url"].replace("{-y}", "{y}")
    bottom = "{-y}" in found["url"] or bool(found.get("tms"))
    return Basemap(
        found.name, url, found.get("attribution", ""), int(found.get("min_zoom", 0)),
        int(found.get("max_zoom", FINEST)), int(found.get("tileSize") or SIDE), bottom,
    )  # fmt: skip
