"""Translate Python's names in messages to those of the command line, or of the window.

The library writes Python in backticks: an argument (```tolerance```), with a value (```tolerance=2```), or a call
(```orograph.bake(store, ["openness"], overwrite=True)```). ``spoken`` renames arguments as instructed; a call becomes
the equivalent command line (``orograph bake STORE --products openness --overwrite``), wherever it is read.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Callable

from orograph.scene.parts import OPTIONS

VERBS = {
    "orograph.store.repair.repair": "orograph build --repair",
    "orograph.fetching.products": "orograph fetch --products",
    "orograph.geovis.color_store.store_colors": "orograph build --color-errors",
}
"""Functions that are options of a verb; others have the name of their verb."""

PLACES = {"orograph.bake": ("", "--products"), "orograph.build": ("", "-o")}
"""The options of arguments that a call gives by position; "": positional in the verb, too."""

ELSEWHERE = {
    **dict.fromkeys(("plot", "show", "draw", "imshow", "relief", "shade"), "render"),
    **dict.fromkeys(("load", "open_dem", "from_file", "read_dem"), "read"),
    **dict.fromkeys(("mosaic", "merge", "store"), "build"),
    **dict.fromkeys(("download", "get_dem"), "fetch"),
    **dict.fromkeys(("flyover", "animate", "film", "video"), "movie"),
    **dict.fromkeys(("mesh", "triangulate"), "tessellate"),
    **dict.fromkeys(("widget", "explore", "viewer"), "view"),
    **dict.fromkeys(("write", "save", "convert", "to_tif", "to_geotiff"), "export"),
    **dict.fromkeys(("elevation", "elevations", "height", "heights", "sample", "interp"), "measure.heights"),
    **{one: f"measure.{one}" for one in ("profile", "viewshed", "line_of_sight", "flood", "area", "pick")},
    **dict.fromkeys(("los", "intervisibility"), "measure.line_of_sight"),
    **dict.fromkeys(("contour", "isolines"), "contours"),
    **dict.fromkeys(("subtract", "diff", "dod", "change"), "difference"),
}  # fmt: skip
"""Names of functions in other tools, and their equivalents here."""

MEANT = {
    **dict.fromkeys(("legend", "scale_bar", "scalebar", "north_arrow", "colorbar", "attribution"), "furniture"),
    **dict.fromkeys(("cmap", "palette", "color", "colors"), "colormap"),
    **dict.fromkeys(("vmin", "vmax", "clim", "zlim", "limits"), "range"),
    **dict.fromkeys(("ve", "vertical_exaggeration", "vert_exag", "z_factor", "zscale", "z_scale"), "exaggeration"),
    **dict.fromkeys(("layer", "overlay", "image", "imagery", "basemap", "texture", "satellite"), "layers"),
    **dict.fromkeys(("threads", "cores", "workers", "n_jobs"), "jobs"),
    **dict.fromkeys(("dpi", "width", "height", "figsize"), "size"),
    **dict.fromkeys(("hillshade", "shading", "lighting"), "light"),
    **dict.fromkeys(("engine", "algorithm"), "method"),
    **dict.fromkeys(("contour", "isolines"), "contours"),
    **dict.fromkeys(("verbose", "quiet"), "progress"),
    **dict.fromkeys(("cellsize", "cell_size", "pixel_size"), "spacing"), **dict.fromkeys(("points", "markers"), "data"),
    **dict.fromkeys(("azdeg", "altdeg", "altitude", "sun_azimuth", "sun_altitude", "angle_altitude"), "sun"),
    "camera": "view",
}  # fmt: skip
"""Names of options in other tools, and their equivalents here."""

Call = Callable[[str], str]
"""The display name of an argument, by its Python name."""


def flag(name: str) -> str:
    """The command-line name of an argument, unless a verb overrides it."""
    return f"--{OPTIONS[name].key if name in OPTIONS else name.replace('_', '-')}"


def spoken(text: str, call: Call) -> str:
    """A text whose Python in backticks is translated."""
    return re.sub("`([^`]+)`", lambda found: _said(found[1], call), text)


def _said(code: str, call: Call) -> str:
    try:
        tree = ast.parse(f"f({code})", mode="eval").body
    except SyntaxError:
        return f"`{code}`"
    assert isinstance(tree, ast.Call)
    words = [_word(one, call) for one in tree.args]
    for given in tree.keywords:
        words += _option(given, call)
    return " ".join(words)


def _word(tree: ast.expr, call: Call) -> str:
    """An argument by its name; or a function of the package, called or not."""
    if isinstance(tree, ast.Name):
        return call(tree.id)
    made = tree if isinstance(tree, ast.Call) else ast.Call(tree, [], [])
    name = ast.unparse(made.func)
    if not name.startswith("orograph."):
        return ast.unparse(tree)
    words = [VERBS.get(name, name.replace(".", " "))]
    for one, place in zip(made.args, [*PLACES.get(name, ()), *[""] * len(made.args)], strict=False):
        if not (isinstance(one, ast.Constant) and one.value is ...):
            words += [*filter(None, [place]), _value(one, "," if place else " ").strip()]
    for given in made.keywords:
        words += _option(given, flag)
    return " ".join(words)


def _option(given: ast.keyword, call: Call) -> list[str]:
    name = call(given.arg or "")
    if isinstance(given.value, ast.Constant) and given.value.value is True:
        return [name]
    if isinstance(given.value, ast.Constant) and given.value.value is False:
        return [f"--no-{name[2:]}" if name.startswith("--") else f"no {name}"]
    return [name, _value(given.value, "x" if given.arg == "size" else ",")]


def _value(tree: ast.expr, between: str = ",") -> str:
    """A value as words of a command line; a name stands for what the user has."""
    if isinstance(tree, ast.Tuple | ast.List):
        return between.join(_value(one) for one in tree.elts)
    if isinstance(tree, ast.Constant):
        return "none" if tree.value is None else shlex.quote(str(tree.value))
    return ast.unparse(tree).upper() if isinstance(tree, ast.Name) else ast.unparse(tree)
