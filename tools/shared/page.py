"""How a page is made: its words are a template of jinja2, its numbers come from the tool, and it is written whole."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from pathlib import Path

import jinja2

from rig.run_folder.recording.folder import write_whole
from shared.table import markdown


def today() -> str:
    """The date that a page is dated by (UTC)."""
    return str(datetime.datetime.now(datetime.UTC).date())


def listed(items: Sequence[str]) -> str:
    """``a, b and c``."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def render(template: Path, **values: object) -> str:
    """The text of a page. Raises jinja2.UndefinedError for what the template names and ``values`` lack.

    Beside jinja2's own filters: ``rows | table(head)`` is a table in Markdown, ``x | kind`` the name of x's class.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=False,  # every text on a page is the project's own
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["table"] = _table
    environment.filters["kind"] = lambda value: type(value).__name__
    return environment.get_template(template.name).render(values)


def write(path: Path, text: str) -> None:
    """Write a page whole, or leave the old one; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode("utf-8"))


def _table(rows: Iterable[Sequence[object]], head: Sequence[str]) -> str:
    return markdown(head, rows)
