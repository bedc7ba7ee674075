"""Sphinx: the pages in docs/, the notebooks in docs/gallery/ (executed), and an API reference from the docstrings.

`make docs` builds the site into build/docs; each warning is an error. The notebooks need the extras viz and learning.
"""

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]
# The notebooks run in processes of their own, and import examples/.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(HERE.parent), os.environ.get("PYTHONPATH")]))

project = "hdsp"
author = "The hdsp authors"
project_copyright = author
release = version = installed_version("hdsp")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "extensions.api_pages",
    "extensions.name_links",
]
exclude_patterns = ["extensions", "jupyter_execute"]
# Names in single backticks are links where the reference has them, and code elsewhere.
default_role = "py:obj"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
suppress_warnings = ["myst-nb.lexer"]  # builds without execution know no language of a cell
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_output_stderr = "remove"  # compilation is announced there, once per machine

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_inherit_docstrings = False  # else methods of Lightning and torch would bring their own
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"
python_maximum_signature_line_length = 100
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
autosummary_generate = True
autosummary_ignore_module_all = False

html_theme = "pydata_sphinx_theme"
html_title = "hdsp"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_nav_level": 1,
    "show_toc_level": 2,
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}

# Each build checks links between pages, headings and names. `make docs-links` fetches the addresses of other sites;
# builds do not, because they also run without a network.
linkcheck_timeout = 20
