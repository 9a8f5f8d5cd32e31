"""Sphinx's settings; `./run docs` builds the pages into docs/_build/html, without a network."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import sources

import fx_beam

project = "fx_beam"
author = "The fx_beam developers"
copyright = "The fx_beam developers, LGPL-3.0-or-later"
version = release = fx_beam.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.linkcode",
    "numpydoc",
    "sphinx_copybutton",
    # Our own: the demos' pages, pages of the sources, formulas by schemes, and without a script.
    "gallery",
    "sources",
    "written",
    "mathml",
]
linkcode_resolve = sources.place_of
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "attrs_block"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "outcomes"]
suppress_warnings = ["config.cache"]  # linkcode_resolve is a function

default_role = "py:obj"
autodoc_typehints = "none"
autosummary_generate = False  # tables only
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"  # the contents of a page are narrow
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# A button on code, not on what a program prints.
copybutton_selector = "div:not(.highlight-text) > div.highlight > pre"

html_theme = "pydata_sphinx_theme"
html_title = f"fx_beam {release}"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_js_files = ["pictures.js"]
html_copy_source = html_show_sourcelink = False
html_sidebars = {
    "first_steps": [],
    "tutorial": [],
    "gallery": [],
    "how_we_know": [],
    "limits": [],
    "related": [],
    "changelog": [],
}
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "navbar_persistent": ["search-button"],
    "show_prev_next": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "navigation_with_keys": False,
}
