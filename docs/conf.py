"""The documentation as a site: `make docs` builds it. The reference is made from the source each time."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "tools")]

from reference_pages import write_pages  # noqa: E402
from rig.core.package import VERSION  # noqa: E402 - needs the path above

project = "rig"
author = "the rig contributors"
release = VERSION
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_click"]
exclude_patterns = ["examples", "figures", "loopback"]
html_theme = "furo"
html_show_copyright = False
html_title = f"rig {release}"
html_extra_path = ["gallery"] if (HERE / "gallery").exists() else []
myst_heading_anchors = 4
nb_execution_mode = os.environ.get("RIG_TUTORIAL", "off")  # `make docs` runs it; so does a test
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 900
autodoc_typehints = "none"  # the signature has them
autodoc_member_order = "bysource"


def _named(match: re.Match[str]) -> str:
    """A link to a file that is no page: its words, and its path in the repository."""
    words, path = match.group(1), match.group(2).replace("../", "")
    return words if path.rstrip("/").endswith(words.strip("`").rstrip("/")) else f"{words} (`{path}`)"


def _read(_app: Sphinx, page: str, text: list[str]) -> None:
    """A page also links to files beside docs/. The site has no such pages: it names them."""
    if not page.startswith("reference/"):
        beside = "../" * (page.count("/") + 1)
        text[0] = re.sub(rf"\[([^\]]*)\]\(((?:{beside}|examples/)[^)#\s]*)(?:#[^)\s]*)?\)", _named, text[0])


def _first_rows(app: Sphinx, page: str, text: list[str]) -> None:
    """Of a table that a tool wrote its first rows, where a build shows no page: the same line makes the others."""
    if app.builder.name == "dummy" and page.startswith("evidence/"):
        text[0] = re.sub(r"(?m)((?:^\|.*\n){8})(?:^\|.*\n)+", r"\1", text[0])


_ROW = re.compile(r"^(\S.*?) {2,}(\S.*)$")  # of a table in a docstring: a name, and what it is


def _told(_app: Sphinx, _what: str, _name: str, _thing: object, _options: object, lines: list[str]) -> None:
    """A docstring's table as a list."""
    out: list[str] = []
    in_row = False
    for line in lines:
        row = _ROW.match(line)
        if row is not None:
            out += ["", f"* ``{row.group(1)}``: {row.group(2)}"]
        elif in_row and line.startswith(" "):
            out[-1] += " " + line.strip()
        else:
            out += ["", line] if in_row else [line]
        in_row = row is not None or (in_row and line.startswith(" "))
    lines[:] = [re.sub(r"\|(\w)", r"\\|\1", line) for line in out]


def _paths(_app: Sphinx, _command: object, lines: list[str]) -> None:
    """A default that is a path, as one types it."""
    lines[:] = [re.sub(r"PosixPath\('([^']*)'\)", r"\1", line) for line in lines]


def setup(app: Sphinx) -> None:
    """Make the reference, and read the pages as the site has them."""
    write_pages(HERE / "reference", HERE / "gallery")
    app.connect("source-read", _read)
    app.connect("source-read", _first_rows)
    app.connect("sphinx-click-process-options", _paths)
    app.connect("autodoc-process-docstring", _told)
