"""Images for sphinx-gallery: every ``Picture`` that a block of code makes."""

from __future__ import annotations

from typing import Any


def _get_sg_image_scraper() -> Any:
    """What sphinx-gallery asks this module for."""
    return scrape


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the pictures among an example's variables that were not saved yet."""
    from sphinx_gallery.scrapers import figure_rst

    from orograph.rendering.picture import Picture

    names = block_vars["example_globals"]
    saved: set[int] = names.setdefault("__saved_pictures__", set())
    paths = []
    for value in list(names.values()):
        if isinstance(value, Picture) and id(value) not in saved:
            saved.add(id(value))
            paths.append(next(block_vars["image_path_iterator"]))
            value.save(paths[-1])
    return figure_rst(paths, gallery_conf["src_dir"])
