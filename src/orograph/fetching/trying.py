"""Check whether the rules for tile names still hold: ask servers for tiles that they must have."""

from __future__ import annotations

import os
from collections.abc import Iterator

from orograph.fetching.areas import Box
from orograph.fetching.asking import Answer, ask, public
from orograph.fetching.products import Product, product_named, products
from orograph.fetching.tiling import lay_out, one_tile
from orograph.parallel import map_ordered


def tried(
    table: str | os.PathLike[str] | None = None, name: str | None = None
) -> Iterator[tuple[Product, str, Answer]]:
    """Products, the URL of a tile at their ``sample``, and its server's current answer.

    Args:
        table: a file of products. name: of one product; None: all.
    """
    chosen = [product_named(name, table)] if name is not None else list(products(table).values())
    urls = [_url(product) for product in chosen]
    answers = map_ordered(lambda url: ask(url, again=False), urls, 4)
    for product, url, answer in zip(chosen, urls, answers):
        yield product, public(url), answer


def _url(product: Product) -> str:
    if product.tiling == "one":
        return one_tile(product).url
    lon, lat = product.sample
    return lay_out(product, Box(lon, lat, lon + 1e-9, lat + 1e-9)).tiles[0].url
