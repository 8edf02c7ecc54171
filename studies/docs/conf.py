"""Settings of Sphinx; ``python studies/docs.py`` builds."""

import functools
import importlib
import logging
import os
import re
import sys
import warnings
from importlib.metadata import distribution
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from sphinx.util.nodes import make_refnode
from sphinx_gallery.scrapers import figure_rst

import adaptmg as am

matplotlib.use("Agg")
logging.getLogger("adaptmg").setLevel(logging.WARNING)  # an extension prints what solvers log
project, author, version = "adaptmg", "adaptmg contributors", am.__version__
release, project_copyright = version, "adaptmg contributors, MIT licence"
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["scripts/*"]
templates_path = ["_templates"]
default_role = "literal"
nitpicky = True
nitpick_ignore = [("py:class", "pathlib.Path")]  # Python's pages are not here
math_numfig = True
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
mathjax_path = "mathjax/tex-chtml.js"

html_theme = "furo"
html_title = f"adaptmg {version}"
html_static_path = ["_static"]
html_css_files = ["docs.css"]
html_show_search_summary = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"font-stack": "system-ui, sans-serif", "code-font-size": ".78rem"}
}

suppress_warnings = ["config.cache"]  # the function below cannot be pickled
_shown = []
# tutorials show what a warning says, not in which folder they were run
warnings.formatwarning = lambda message, category, *_: f"{category.__name__}: {message}\n"


def _pictures(block, names, settings):
    """Save the figure that a block of a tutorial ends with; pyplot does not keep those of
    adaptmg."""
    value, paths = names["example_globals"].get("___"), []
    if isinstance(value, Figure) and value not in _shown:
        _shown.append(value)
        paths = [next(names["image_path_iterator"])]
        value.savefig(paths[0], dpi=150)
    return figure_rst(paths, settings["src_dir"])


sphinx_gallery_conf = {
    "examples_dirs": "scripts",
    "gallery_dirs": "tutorials",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "capture_repr": ("_repr_html_",),
    "image_scrapers": ("matplotlib", _pictures),
    "write_computation_times": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "download_all_examples": False,
    "remove_config_comments": True,
    "plot_gallery": "QUICK_DOCS" not in os.environ,
}


@functools.cache
def _guides(source):
    """Return the texts of how-tos, tutorials and pages of the theory by the names of their pages."""
    pages = {f"/howto/{page.stem}": page for page in sorted((source / "howto").glob("*.rst"))}
    pages |= {f"/tutorials/{page.stem}": page for page in sorted((source / "scripts").glob("*.py"))}
    pages |= {f"/theory/{page.stem}": page for page in sorted((source / "theory").glob("*.rst"))}
    return {name: page.read_text(encoding="utf-8") for name, page in pages.items()}


def _in_use(app, what, name, thing, options, lines):
    """Add links to pages that use a public name."""
    if what in ("class", "function", "exception", "data"):
        # a class stands on its page under the name of its module
        short = name.rpartition(".")[2]
        used = re.compile(rf"\b(?:am|adaptmg)\.(?:\w+\.)?{short}\b|``(?:\w+\.)?{short}\b")
        guides = [page for page, text in _guides(Path(app.srcdir)).items() if used.search(text)]
        if guides:
            links = ", ".join(f":doc:`{page}`" for page in guides[:_MOST_GUIDES])
            lines += ["", ".. rubric:: In use", "", links, ""]


_MOST_GUIDES = 5
_pages = {}


def _resolve(app, environment, node, content):
    """Lead a reference to the page of the public name; a name inside the package that has no page
    stays text."""
    objects = environment.get_domain("py").objects
    if not _pages:
        for name in objects:
            _pages.setdefault(name.rpartition(".")[2], name)
    target = node.get("reftarget", "")
    parts = target.split(".")
    for length in (1, 2):  # a name, or an attribute of a name
        name = _pages.get(parts[-length]) if length <= len(parts) else None
        if name and (length == 1 or name[len("adaptmg.") :][0].isupper()):
            entry = objects[name]
            return make_refnode(
                app.builder, node["refdoc"], entry.docname, entry.node_id, content, name
            )
    return content if _exists(parts) else None


def _exists(parts):
    """Return whether a dotted name, or a bare one in some module, belongs to the package."""
    if len(parts) == 1 or parts[0] != "adaptmg":
        modules = [module for name, module in sys.modules.items() if name.startswith("adaptmg.")]
        return any(hasattr(module, parts[0]) for module in modules)
    value = importlib.import_module("adaptmg")
    for length in range(2, len(parts) + 1):
        try:
            value = importlib.import_module(".".join(parts[:length]))
        except ImportError:
            value = getattr(value, parts[length - 1], None)
            if value is None:
                return False
    return True


def setup(app):
    """Copy MathJax, and connect the references."""
    app.connect("missing-reference", _resolve)
    app.connect("autodoc-process-docstring", _in_use, priority=900)  # after numpydoc
    root = Path(
        str(
            distribution("sphinx-mathjax-offline").locate_file(
                "sphinx-mathjax-offline/static/mathjax"
            )
        )
    )

    def mathjax(app, error):
        from sphinx.util.fileutil import copy_asset

        if error is None:
            target = app.outdir / "_static" / "mathjax"
            target.mkdir(parents=True, exist_ok=True)
            copy_asset(root / "tex-chtml.js", target)
            copy_asset(root / "output/chtml/fonts/woff-v2", target / "output/chtml/fonts/woff-v2")

    app.connect("build-finished", mathjax)
