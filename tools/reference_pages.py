"""The reference of the documentation, made from the source: commands, keys, results, faults, Python; the gallery.

``python tools/reference_pages.py FOLDER``; `make docs` does it by itself.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from results_page import in_order, kind, page_text
from rig import config
from rig.core.faults import FAULTS
from shared import page
from shared.table import markdown

COMMANDS = """# Commands and options

For everybody who looks up an option. Made from the commands themselves.
What they say, and what options mean everywhere: [commands](../commands.md).

```{eval-rst}
.. click:: rig.cli:main
   :prog: rig
   :nested: full
```
"""
PYTHON = """# Python

For everybody who looks up a function. Made from the docstrings. With examples: [Python](../api.md).

```{eval-rst}
.. automodule:: rig.api
   :members:
   :imported-members:
```
"""


def write_pages(folder: Path, gallery: Path) -> None:
    """Write the pages. One that is there and the same stays as it is, so that a build need not read it again.

    gallery   where reports are, if they were made
    """
    folder.mkdir(exist_ok=True)
    pages = {
        "commands": COMMANDS,
        "keys": keys(),
        "results": page_text(),
        "faults": faults(),
        "python": PYTHON,
        "gallery": reports(gallery),
    }
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            page.write(path, text)


def faults() -> str:
    """A table of all faults: code, cause, cure."""
    rows = [(f"`{code}`", entry.cause, entry.cure_with()) for code, entry in FAULTS.items()]
    table = markdown(("code", "what happened", "what to do"), rows)
    return f"# Faults\n\nFor everybody whose run has ended early: what ends a run, why, and what to do.\n\n{table}\n"


def reports(gallery: Path) -> str:
    """Links to the reports of the gallery, or how to make them."""
    titles, head = gallery / "titles.json", "# Gallery of reports\n\nFor everybody who wants to see a report.\n\n"
    if not titles.exists():
        return f"{head}This build has none: `make docs` makes them.\n"
    named = json.loads(titles.read_text(encoding="utf-8"))
    links = "\n".join(f'<li><a href="../{name}.html">{title}</a></li>' for name, title in named.items())
    return f"{head}What `rig run` reports of four emulated benches.\n\n<ul>\n{links}\n</ul>\n"


def keys() -> str:
    """A table for each section of a config."""
    schema = json.loads(config.schema_text(config.Experiment))
    parts = schema.pop("$defs", {})
    text = [
        "# Keys of a config",
        "",
        "For everybody who writes a config: every key, its default, its range. `rig config list` names ready configs.",
        "",
    ]
    text += ["## The config", "", _table(schema)]
    for name in in_order(schema, parts):
        text += ["", f"### {name}", "", parts[name].get("description", ""), "", _table(parts[name])]
    return "\n".join(text) + "\n"


def _table(schema: dict[str, Any]) -> str:
    required = schema.get("required", [])
    rows = [
        (f"`{key}`", kind(of) + _range(of), "needed" if key in required else _default(of), of.get("description", ""))
        for key, of in schema.get("properties", {}).items()
    ]
    return markdown(("key", "value", "default", "what"), rows)


def _default(of: dict[str, Any]) -> str:
    value = of.get("default")
    return "" if value is None or isinstance(value, dict) else f"`{json.dumps(value)}`"


def _range(of: dict[str, Any]) -> str:
    bounds = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    said = [f"{sign} {of[name]}" for name, sign in bounds.items() if name in of]
    return f", {', '.join(said)}" if said else ""


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]), Path(sys.argv[1]).parent / "gallery")
