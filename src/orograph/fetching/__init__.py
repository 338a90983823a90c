"""Open elevation models by place: the available products, and reading areas of them from public storage.

>>> import orograph
>>> dem = orograph.fetch((7.5, 45.9, 7.8, 46.1))                              # doctest: +SKIP
>>> dem = orograph.fetch((-71.3, 44.27), "3dep-30", radius=10_000)            # doctest: +SKIP
>>> terrain = orograph.fetch((7.5, 45.9, 7.8, 46.1), output="matterhorn.oro")  # doctest: +SKIP
"""

from __future__ import annotations

from orograph.fetching.api import fetch
from orograph.fetching.products import Product, products, register
from orograph.fetching.request import Plan, Request

__all__ = ["Plan", "Product", "Request", "fetch", "products", "register"]
