"""The documentation site: what `make docs` builds from the Markdown pages that GitHub shows, and from the docstrings.

The source folder is the repository, so that a link leads to the same file here and on GitHub. `tools/docs` makes every
warning an error: a link to nothing, a page outside the navigation, a name that autodoc cannot resolve.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from pygments.lexer import RegexLexer, words
from pygments.lexers import JsonLexer
from pygments.token import Comment, Keyword, Literal, Name, Number, Operator, String, Text
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import midstride
from midstride.lang.token_stream import RESERVED

ROOT = Path(__file__).resolve().parent.parent

NAVIGATION = {
    "Start": ["docs/tutorial"],
    "Examples": [
        f"examples/{name}/README" for name in ("talker", "obstacle", "filter", "patrol", "suave", "autoware_control")
    ],
    "How to": ["docs/how-to/*"],
    "Reference": [
        *(
            f"docs/reference/{page}"
            for page in ("ten-commands", "commands", "language", "diagnostics", "metrics", "api", "distributions")
        ),
        "docs/http",
    ],
    "Explanation": [
        *(f"docs/{page}" for page in ("semantics", "architecture", "assurance", "benchmarks", "swap-comparison")),
        *(f"docs/{page}" for page in ("decisions/README", "paper", "glossary")),
        "CHANGELOG",
    ],
    "Contribute": ["CONTRIBUTING", "docs/style", "HACKING", "SECURITY", "RELEASING"],
}

# Pages that are listed by another one, below which they are.
BELOW = {"docs/decisions/README": "docs/decisions/[!R]*", "docs/semantics": "docs/protocols/*"}

CREATED_BY = {"AnyOf": "any_of", "Approximate": "approximate", "Guarantee": "guarantee", "Interval": "between"}

project = "Midstride"
author = "the authors of Midstride"
version = release = midstride.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
root_doc = "README"
include_patterns = ["*.md", "docs/**.md", "examples/*/README.md"]
exclude_patterns = [".*", "benchmarks", "build", "dist", "editors", "site", "src", "tests", "tools"]

myst_heading_anchors = 4  # as on GitHub

nitpicky = True
# The standard library's documentation is on another host, so its names are not links.
nitpick_ignore_regex = [("py:class", r"collections\.abc\.\w+"), ("py:class", r".*\.F")]
add_module_names = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = f"Midstride {release}"
html_copy_source = False
html_show_copyright = False
html_show_search_summary = False  # it would be fetched, which browsers refuse to pages from the disk
html_show_sphinx = False


class StrideLexer(RegexLexer):
    """The colours of a specification."""

    name = "Stride"
    tokens: ClassVar = {
        "root": [
            (r"#.*$", Comment.Single),
            (r'"(?:\\.|[^"\\])*"', String.Double),
            (r"[~/]?[A-Za-z_]\w*(?:/\w+)+|[~/][A-Za-z_]\w*", Literal),
            (words(sorted(RESERVED), suffix=r"\b"), Keyword),
            (r"[A-Za-z_]\w*", Name),
            (r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?", Number),
            (r"->|<-|[<>=@:]+", Operator),
            (r"\s+|.", Text),
        ]
    }


def add_navigation(app: Sphinx, document: str, source: list[str]) -> None:
    """The tables of contents, which GitHub has no use for, at the end of the start page, and of those in `BELOW`."""
    if document == app.config.root_doc:
        for caption, pages in NAVIGATION.items():
            listed = "\n".join(f"/{page}" for page in pages)
            source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n:caption: {caption}\n\n{listed}\n```\n"
    if document in BELOW:
        source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n\n/{BELOW[document]}\n```\n"


def unlink_folders(app: Sphinx, page: nodes.document) -> None:
    """GitHub shows folders, the site does not: here a link to one is its text."""
    beside = (ROOT / app.env.docname).parent
    for link in list(page.findall(pending_xref)):
        if link["reftype"] == "myst" and (beside / link["reftarget"]).is_dir():
            link.replace_self(link.children)


def link_to_api(
    app: Sphinx, environment: BuildEnvironment, node: pending_xref, text: nodes.Element
) -> nodes.Element | None:
    """A type in a signature is documented where an author imports it from, or at the function that creates it."""
    name = node["reftarget"].rpartition(".")[2]
    target = f"midstride.{CREATED_BY.get(name, name)}"
    python = environment.domains["py"]
    return python.resolve_xref(environment, node["refdoc"], app.builder, "obj", target, node, text)


def hide_constructor(app: Sphinx, what: str, name: str, *rest: object) -> tuple[str, None] | None:
    """Only a component is created by its class, everything else by a method or function."""
    return ("", None) if what == "class" and name not in ("midstride.Component", "midstride.QoS") else None


def link_to_semantics(app: Sphinx, what: str, name: str, subject: object, options: object, lines: list[str]) -> None:
    text = re.sub(r"docs/semantics\.md\s+(section \d)", r":doc:`semantics, \1 </docs/semantics>`", "\n".join(lines))
    text = re.sub(r"docs/protocols/(\w+)\.md", r":doc:`\1 </docs/protocols/\1>`", text)
    lines[:] = text.split("\n")


def add_index(app: Sphinx, exception: Exception | None) -> None:
    if exception is None:
        shutil.copyfile(Path(app.outdir, "README.html"), Path(app.outdir, "index.html"))


def setup(app: Sphinx) -> None:
    app.add_lexer("stride", StrideLexer)
    app.add_lexer("json-example", JsonLexer)
    app.connect("source-read", add_navigation)
    app.connect("doctree-read", unlink_folders)
    app.connect("missing-reference", link_to_api)
    app.connect("autodoc-process-signature", hide_constructor)
    app.connect("autodoc-process-docstring", link_to_semantics)
    app.connect("build-finished", add_index)
