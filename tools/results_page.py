"""docs/results.md and the JSON Schemas beside it, made from the models: ``python tools/results_page.py``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rig.results import Part, RunMeta, RunResult
from rig.results.json_schema import schema_text

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGE = "results.md"
ANYTHING = "JsonValue"  # how the schema calls any value of JSON
SCHEMAS: dict[str, type[Part]] = {"meta-schema.json": RunMeta, "result-schema.json": RunResult}

HEAD = """\
# What a run folder says: meta.json and result.json

rig writes `meta.json` when a run begins: what ran, on which device, with which times. It writes `result.json` when
the run has ended: what came of it. `rig run --json` prints `result.json` with `ok` and `folder` before it
([commands.md](commands.md)).

* `schema` is the version of the file's form: 1. Every version of rig has written it.
* A key that ends in a unit (`_s`, `_V`, `_rad`) is a number in that unit. `null` means: not known.
* *Always* below means: this version always writes the key. An older version may not have known it.
* The JSON Schemas, to check files with: [meta-schema.json](meta-schema.json), [result-schema.json](result-schema.json).
  `rig schema --of result` prints the one of your version.

How rig reads these files:

| the file | rig |
|---|---|
| lacks a key | reads on. `rig replay` names the key that it needs |
| has a key that this version does not know | reads on, and names the key |
| has a larger `schema` | reads on, and says that a newer version wrote it |
| has a wrong value (a text for a number) | leaves that key out, says so, and uses the rest |
| the same, in `rig replay` | names file, key and value, and stops with exit status 2 |

This page is made from the models in `rig/results` by `python tools/results_page.py`.
"""


def main() -> int:
    """Write the page and the schemas."""
    (DOCS / PAGE).write_text(page_text(), encoding="utf-8")
    for name, model in SCHEMAS.items():
        (DOCS / name).write_text(schema_text(model), encoding="utf-8")
    return 0


def page_text() -> str:
    """The page: a table for each file, then one for each part, in the order in which they are met."""
    sections = [HEAD]
    told: set[str] = set()
    for title, model in (("meta.json", RunMeta), ("result.json", RunResult)):
        schema = json.loads(schema_text(model))
        parts = schema.pop("$defs", {})
        sections.append(f"## {title}\n\n{_table(schema)}")
        for name in _in_order(schema, parts):
            if name not in told:
                told.add(name)
                sections.append(f"### {name}\n\n{parts[name]['description']}\n\n{_table(parts[name])}")
    return "\n".join(sections)


def _table(schema: dict[str, Any]) -> str:
    lines = ["| key | value | always | what |", "|---|---|---|---|"]
    required = schema.get("required", [])
    for key, of in schema["properties"].items():
        lines.append(f"| `{key}` | {_kind(of)} | {'yes' if key in required else ''} | {of.get('description', '')} |")
    return "\n".join(lines) + "\n"


def _kind(of: dict[str, Any]) -> str:
    """The type of a key in words, a part as a link."""
    if "$ref" in of:
        name = _name(of)
        if name == ANYTHING:
            return "any value"
        return f"[{name}](#{name.lower()})"
    if "anyOf" in of:
        return " or ".join(dict.fromkeys(_kind(one) for one in of["anyOf"]))
    if "enum" in of:
        return " or ".join(f"`{one}`" for one in of["enum"])
    kind = of.get("type", "any")
    if kind == "array":
        items = of.get("items")
        if items is None:
            return " and ".join(dict.fromkeys(_kind(one) for one in of.get("prefixItems", [])))
        return f"list of {_kind(items)}"
    if kind == "object":
        values = of.get("additionalProperties")
        return f"by name: {_kind(values)}" if isinstance(values, dict) and values else "object"
    words = {"string": "text", "integer": "whole number", "boolean": "true or false"}
    return words.get(kind, str(kind))


def _in_order(schema: dict[str, Any], parts: dict[str, Any]) -> list[str]:
    """The parts that a schema refers to, in the order in which they are met, each before its own."""
    found: list[str] = []

    def visit(value: object) -> None:
        if isinstance(value, dict):
            if "$ref" in value and (name := _name(value)) not in (*found, ANYTHING):
                found.append(name)
                visit(parts[name].get("properties"))
            for item in value.values():
                visit(item)
        elif isinstance(value, list):
            for item in value:
                visit(item)

    visit(schema["properties"])
    return found


def _name(reference: dict[str, Any]) -> str:
    return str(reference["$ref"]).rpartition("/")[2]


if __name__ == "__main__":
    sys.exit(main())
