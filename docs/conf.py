"""Settings of the documentation; ``sphinx-build -W docs docs/_build/html``."""

import os
import re
import sys
from importlib import resources
from pathlib import Path

import matplotlib as mpl
from sphinx_gallery.sorting import ExplicitOrder

import sklearn_vbjfa

mpl.use("Agg")
# The guide's own directives.
sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "sklearn_vbjfa"
author = "The sklearn_vbjfa developers"
copyright = author
release = version = sklearn_vbjfa.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.extlinks",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "effect_pages",
    "llms",
]
templates_path = ["_templates"]
# tables/ holds data of the page evidence.md.
exclude_patterns = ["_build", "tables", "Thumbs.db"]
root_doc = "index"

extlinks = {"doi": ("https://doi.org/%s", "doi:%s")}
autosummary_generate = True
autodoc_member_order = "bysource"
# "fit()" beside the page of a class, not "RobotIdentifier.fit()".
toc_object_entries_show_parents = "hide"
# The class pages list the members themselves, see _templates/autosummary/class.rst.
numpydoc_show_class_members = False
# `name` in a docstring is a name of Python, linked where there is a page for it.
default_role = "autolink"

html_theme = "pydata_sphinx_theme"
html_title = f"{project} {release}"
html_theme_options = {
    "logo": {"text": project},
    "navigation_with_keys": False,
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    # The version of Sphinx and of the theme helps nobody who reads this.
    "footer_start": ["copyright"],
    "footer_end": [],
}
# Where the pages of all versions are published, and which these are: the workflow says
# so. Pages that are built elsewhere are alone, and need no network.
_site = os.environ.get("DOCS_SITE", "").rstrip("/")
if _site:
    html_baseurl = f"{_site}/"
    html_theme_options |= {
        "switcher": {
            "json_url": f"{_site}/switcher.json",
            "version_match": os.environ["DOCS_VERSION"],
        },
        "check_switcher": False,
        "show_version_warning_banner": True,
        "navbar_end": ["version-switcher", "theme-switcher", "navbar-icon-links"],
    }
# The first page leads on by itself.
html_sidebars = {"index": []}
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
# The report of the demonstration, made by demo_report.py.
html_extra_path = ["demo-report.html"]

# MathJax from the installed package, with every extension and its glyphs in one file:
# formulas are shown without a network, from a folder too.
_mathjax = resources.files("mathjax") / "static" / "mathjax" / "es5"
html_static_path.append(str(_mathjax / "tex-svg-full.js"))
mathjax_path = "tex-svg-full.js"

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "auto_examples",
    "filename_pattern": r"/plot_",
    "ignore_pattern": r"paper_robots",
    # The task first, then methods, then the figures of the paper.
    "subsection_order": ExplicitOrder(
        [
            "../examples/1_quickstart",
            "../examples/2_methods",
            "../examples/3_articles",
        ]
    ),
    "within_subsection_order": "gallery_order.MostWantedFirst",
    "write_computation_times": False,
    "show_memory": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "abort_on_example_error": True,
}


def _skip(app, what, name, obj, skip, options):
    """Leave out what scikit-learn adds to every estimator for metadata routing."""
    return True if re.fullmatch(r"set_\w+_request", name) else None


def setup(app):
    """Connect the handlers of this file."""
    app.connect("autodoc-skip-member", _skip)
