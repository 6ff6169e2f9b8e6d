"""The keys of meta.json and result.json, from the models: for the reference, and as the JSON Schemas in docs/.

``python tools/results_page.py`` writes the schemas.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rig.run_folder.results import Part, RunMeta, RunResult
from rig.run_folder.results.result import schema_text
from shared import page
from shared.table import markdown

DOCS = Path(__file__).resolve().parent.parent / "docs"
ANYTHING = "JsonValue"  # how the schema calls any value of JSON
SCHEMAS: dict[str, type[Part]] = {"meta-schema.json": RunMeta, "result-schema.json": RunResult}


def main() -> int:
    """Write the schemas."""
    for name, model in SCHEMAS.items():
        page.write(DOCS / name, schema_text(model))
    return 0


def page_text() -> str:
    """A page of the reference: a table for each file, then one for each part, in the order in which they are met."""
    text = [
        "# Keys of meta.json and result.json",
        "",
        "For everybody who reads a run folder with a program. *Always*: this version always writes the key. How rig",
        "reads these files: [results](../results.md).",
    ]
    told: set[str] = set()
    for title, model in (("meta.json", RunMeta), ("result.json", RunResult)):
        schema = json.loads(schema_text(model))
        parts = schema.pop("$defs", {})
        text += ["", f"## {title}", "", _table(schema)]
        for name in in_order(schema, parts):
            if name not in told:
                told.add(name)
                text += ["", f"### {name}", "", parts[name]["description"], "", _table(parts[name])]
    return "\n".join(text) + "\n"


def _table(schema: dict[str, Any]) -> str:
    required = schema.get("required", [])
    rows = [
        (f"`{key}`", kind(of), "yes" if key in required else "", of.get("description", ""))
        for key, of in schema["properties"].items()
    ]
    return markdown(("key", "value", "always", "what"), rows)


def kind(of: dict[str, Any]) -> str:
    """The type of a key in words, a part as a link."""
    if "$ref" in of:
        name = _name(of)
        if name == ANYTHING:
            return "any value"
        return f"[{name}](#{name.lower()})"
    if "anyOf" in of:
        return " or ".join(dict.fromkeys(kind(one) for one in of["anyOf"]))
    if "enum" in of:
        return " or ".join(f"`{one}`" for one in of["enum"])
    word = of.get("type", "any")
    if word == "array":
        items = of.get("items")
        if items is None:
            return " and ".join(dict.fromkeys(kind(one) for one in of.get("prefixItems", [])))
        return f"list of {kind(items)}"
    if word == "object":
        values = of.get("additionalProperties")
        return f"by name: {kind(values)}" if isinstance(values, dict) and values else "object"
    words = {"string": "text", "integer": "whole number", "boolean": "true or false"}
    return words.get(word, str(word))


def in_order(schema: dict[str, Any], parts: dict[str, Any]) -> list[str]:
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
