"""``--drape``: images and rasters laid over the ground, for all verbs that draw.

``@layers_option`` gives a verb ``layers``, texts as ``geovis.layers.Layer.parse`` reads them; ``layers_of_options``
makes layers of them, and says before any work is done what is wrong with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import F

if TYPE_CHECKING:
    from orograph.geovis.layers import Layer


def layers_option(function: F) -> F:
    """Give a verb ``--drape``."""
    return click.option(
        "--drape",
        "layers",
        multiple=True,
        metavar="IMAGE[,KEY=VALUE…]",
        help="Lay an image or a raster in any CRS over the ground; give it again for each, bottom to top. Keys: "
        "opacity (0 to 1), blend (normal, multiply), colormap, range (LOW:HIGH), band and nodata of a raster, visible, "
        "name: rain.tif,colormap=viridis,range=0:80,opacity=0.6",
    )(function)


def layers_of_options(options: Mapping[str, Any]) -> tuple[Layer, ...]:
    """The layers that the command line describes, bottom to top.

    Raises:
        UsageError: one cannot be understood, or there are too many. ReadError: a file is not there.
    """
    if not options["layers"]:
        return ()
    from orograph.dem.handles import locate
    from orograph.geovis.layers import Layer, layers_of

    found = layers_of([Layer.parse(text) for text in options["layers"]])
    for layer in found:
        locate(layer.path)
    return found


def layer_files(options: Mapping[str, Any]) -> list[str]:
    """The paths of all layers."""
    return [layer.path for layer in layers_of_options(options)]
