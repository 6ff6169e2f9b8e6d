"""The JSON Schema for editors: current, complete, and of one mind with the loader."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from rig.config import json_schema, schema_text

CONFIGS = Path(__file__).parents[2] / "config"
NAMES = sorted(path.name for path in CONFIGS.glob("*.yaml"))


def validator() -> jsonschema.Draft202012Validator:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_the_checked_in_schema_is_current() -> None:
    """If this fails: `rig schema --out config/schema.json`."""
    assert (CONFIGS / "schema.json").read_text(encoding="utf-8") == schema_text()
    assert json.loads(schema_text()) == json_schema()


def test_the_ready_configs_are_there() -> None:
    assert {"demo.yaml", "simulated.yaml", "least-squares.yaml", "uno.yaml"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_ready_configs_are_valid_and_name_the_schema(name: str) -> None:
    text = (CONFIGS / name).read_text(encoding="utf-8")
    assert text.splitlines()[0] == "# yaml-language-server: $schema=schema.json"
    validator().validate(yaml.safe_load(text))


@pytest.mark.parametrize("section", [None, "daq", "sensor", "drive", "limits", "relay", "tracking", "emulated"])
def test_unknown_keys_are_refused_in_every_section(section: str | None) -> None:
    data = yaml.safe_load((CONFIGS / "demo.yaml").read_text(encoding="utf-8"))
    (data if section is None else data[section])["cyles"] = 12
    with pytest.raises(jsonschema.ValidationError, match="cyles"):
        validator().validate(data)


def properties(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for section in [schema, *schema["$defs"].values()]:
        yield from section["properties"].items()


def test_every_key_is_described() -> None:
    schema = json_schema()
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["title"] == "rig experiment"
    undescribed = [key for key, described in properties(schema) if not described.get("description")]
    assert undescribed == []
    assert all(section["additionalProperties"] is False for section in [schema, *schema["$defs"].values()])
