"""Configuration of the documentation site: `python -m sphinx -W docs FOLDER` builds it (extra ``docs``)."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "_build_tools"))

from generate import write_pages  # noqa: E402, on the path set above

project = "hpe_rig"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "_build_tools"]
html_theme = "pydata_sphinx_theme"
html_title = "hpe_rig"
html_show_copyright = False
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_persistent": [],
    "navbar_end": ["theme-switcher", "search-button"],
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
    "header_links_before_dropdown": 8,
}
# A link to a heading is written as GitHub writes it.
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "dollarmath"]
# A single name in backticks is code, as in the Markdown pages.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False
nitpicky = False

write_pages(DOCS / "reference" / "generated")
