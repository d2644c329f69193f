"""The site: `make docs` builds it below build/docs, and every warning is an error."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402

from inim.system.version import __version__  # noqa: E402

generate.write(HERE)

project = "inim"
author = "the inim authors"
copyright = author  # noqa: A001
release = version = __version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["generated", "notebooks/out"]
html_theme = "furo"
html_title = f"inim {version}"
html_static_path = ["static"]
html_extra_path = ["generated/site"]
html_css_files = ["site.css"]
html_search_scorer = str(HERE / "search-scorer.js")
html_theme_options = {"navigation_with_keys": True}

myst_enable_extensions = ["attrs_block", "colon_fence", "dollarmath", "html_image"]
myst_heading_anchors = 3
copybutton_exclude = ".linenos, .gp"

# Notebooks are kept without results; the build runs them, anew only where one has changed.
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_show_tb = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings state types, shapes and units
numpydoc_show_class_members = False
numpydoc_validation_checks = {"PR02", "PR10"}
numpydoc_xref_param_type = False


# Formulas become MathML, which browsers draw themselves: no script, no network.
html_math_renderer = "mathml"


def _math(translator: Any, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _display_math(translator: Any, node: nodes.math_block) -> None:
    named = f' id="{node["ids"][0]}"' if node["ids"] else ""
    number = f'<span class="eqno">({node["number"]})</span>' if node["number"] else ""
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div class="math"{named}>{formula}{number}</div>')
    raise nodes.SkipNode


def _link_gallery(
    _app: Any, _kind: str, name: str, _value: Any, _options: Any, lines: list[str]
) -> None:
    """Append the gallery's examples of a public name to its docstring."""
    if links := generate.gallery_links(name, ":ref:`{} <{}>`"):
        lines += ["", ".. rubric:: Gallery", "", links, ""]


def _remove_back_links(
    _app: Any, page: str, _template: str, context: dict[str, Any], _tree: Any
) -> None:
    """Remove the links from source code to the reference: those of some names are wrong."""
    if page.startswith("_modules/"):
        context["body"] = re.sub(r'<a class="viewcode-back".*?</a>', "", context["body"])


def setup(app: Any) -> None:
    """Register the formulas and the links to the gallery with Sphinx."""
    app.add_html_math_renderer("mathml", (_math, None), (_display_math, None))
    # After numpydoc, which divides docstrings into sections.
    app.connect("autodoc-process-docstring", _link_gallery, priority=900)
    app.connect("html-page-context", _remove_back_links)
