"""How the documentation is built: Sphinx, MyST and furo, from these pages, the files' models and the code."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from horizonval import __version__

project = "horizonval"
author = "The horizonval authors"
copyright = "2026, The horizonval authors"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "reference"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_ext"]

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

smartquotes = False
# Attributes of two classes may have one name; a text that means neither is no reference.
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_title = "horizonval"
html_static_path = ["_static"]
html_css_files = ["horizonval.css"]
html_show_sourcelink = False
html_copy_source = False
