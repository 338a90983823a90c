"""The documentation site: these pages, a reference made of docstrings, a gallery whose pictures its code makes."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from fresh import is_stale

project = "Orograph"
author = "the Orograph authors"
release = version = version_of("orograph")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
    "fresh",
]
root_doc = "index"
exclude_patterns = [
    "_build",
    "_ext",
    "examples/**",
    "tutorials/**",
    "made/**/*.ipynb",
    "made/**/*.py",
    "made/**/*.zip",
    "made/sg_execution_times.rst",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4

html_theme = "pydata_sphinx_theme"
html_title = "Orograph"
html_theme_options = {"navigation_depth": 2, "show_toc_level": 2, "secondary_sidebar_items": ["page-toc"]}
html_sidebars = {"**": ["sidebar-nav-bs"]}

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_param = napoleon_use_rtype = napoleon_use_ivar = False

sphinx_gallery_conf = {
    "examples_dirs": ["examples", "tutorials"],
    "gallery_dirs": ["made/gallery", "made/tutorials"],
    "image_scrapers": ("matplotlib", "picture_scraper"),
    "capture_repr": ("_repr_html_", "__repr__"),
    "ignore_repr_types": r"Picture|matplotlib|BarContainer|Text|list|AxesImage|FillBetween",
    "within_subsection_order": "FileNameSortKey",
    "filename_pattern": r"\.py$",
    "run_stale_examples": is_stale(),
    "min_reported_time": 1e9,
    "show_signature": False,
    "download_all_examples": False,
}
