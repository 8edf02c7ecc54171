"""Settings of Sphinx; ``python studies/docs.py`` builds."""

import importlib
from importlib.metadata import distribution

import matplotlib
from sphinx.util.nodes import make_refnode

import adaptmg as am

matplotlib.use("Agg")
project, author, version = "adaptmg", "adaptmg contributors", am.__version__
release, project_copyright = version, "adaptmg contributors, MIT licence"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["tutorials/*", "measured"]
templates_path = ["_templates"]
default_role = "literal"
nitpicky = True
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
html_theme_options = {"light_css_variables": {"font-stack": "system-ui, sans-serif"}}

sphinx_gallery_conf = {
    "examples_dirs": "tutorials", "gallery_dirs": "learn", "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey", "abort_on_example_error": True, "capture_repr": ("_repr_html_", "__repr__"),
    "image_srcset": ["2x"], "write_computation_times": False, "show_memory": False, "download_all_examples": False,
    "remove_config_comments": True, "plot_gallery": True,
}

_names = {}


def _index(environment):
    """Names of documented objects, also under the module that defines them."""
    for name, entry in environment.get_domain("py").objects.items():
        module, _, last = name.rpartition(".")
        try:
            home = getattr(getattr(importlib.import_module(module), last), "__module__", None)
        except (ImportError, AttributeError):
            continue
        _names[f"{home}.{last}"] = (name, entry)


def _resolve(app, environment, node, content):
    """A reference to the module that defines a public name leads to the page of its public name."""
    if not _names:
        _index(environment)
    target = node.get("reftarget", "")
    found = _names.get(target)
    attribute = ""
    if found is None:
        target, _, attribute = target.rpartition(".")
        found = _names.get(target)
    if found is None:
        return None
    name, entry = found
    anchor = f"{name}.{attribute}" if attribute else name
    if attribute and anchor not in environment.get_domain("py").objects:
        anchor = name
    return make_refnode(app.builder, node["refdoc"], entry.docname, anchor, content, name)


def setup(app):
    """Copy MathJax, and connect the references."""
    app.connect("missing-reference", _resolve)
    root = distribution("sphinx-mathjax-offline").locate_file("sphinx-mathjax-offline/static/mathjax")

    def mathjax(app, error):
        from sphinx.util.fileutil import copy_asset
        if error is None:
            target = app.outdir / "_static" / "mathjax"
            target.mkdir(parents=True, exist_ok=True)
            copy_asset(root / "tex-chtml.js", target)
            copy_asset(root / "output/chtml/fonts/woff-v2", target / "output/chtml/fonts/woff-v2")

    app.connect("build-finished", mathjax)
