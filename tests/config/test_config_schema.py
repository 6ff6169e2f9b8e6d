"""The JSON Schema for editors: current, complete, and of one mind with the loader."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from rig.config import Campaign, Experiment, json_schema, schema_text

CONFIGS = Path(__file__).parents[2] / "config"
NAMES = sorted(path.name for path in CONFIGS.glob("*.yaml"))


FILES = {Experiment: "schema.json", Campaign: "campaign-schema.json"}


@cache
def validator(of: type[Experiment] | type[Campaign] = Experiment) -> jsonschema.Draft202012Validator:
    schema = json_schema(of)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("of", FILES)
def test_the_checked_in_schema_is_current(of: type[Experiment] | type[Campaign]) -> None:
    """If this fails: `rig schema --to config/schema.json`, and with `--campaign` config/campaign-schema.json."""
    assert (CONFIGS / FILES[of]).read_text(encoding="utf-8") == schema_text(of)
    assert json.loads(schema_text(of)) == json_schema(of)


def test_the_ready_configs_are_there() -> None:
    assert {"demo.yaml", "quick.yaml", "least-squares.yaml", "uno.yaml"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_ready_configs_are_valid_and_name_the_schema(name: str) -> None:
    text = (CONFIGS / name).read_text(encoding="utf-8")
    of = Campaign if name.startswith("campaign") else Experiment
    assert text.splitlines()[0] == f"# yaml-language-server: $schema={FILES[of]}"
    validator(of).validate(yaml.safe_load(text))


@pytest.mark.parametrize("section", [None, "daq", "sensor", "drive", "limits", "relay", "tracking", "emulated"])
def test_unknown_keys_are_refused_in_every_section(section: str | None) -> None:
    data = yaml.safe_load((CONFIGS / "demo.yaml").read_text(encoding="utf-8"))
    (data if section is None else data[section])["cyles"] = 12
    with pytest.raises(jsonschema.ValidationError, match="cyles"):
        validator().validate(data)


def properties(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for section in [schema, *schema["$defs"].values()]:
        yield from section["properties"].items()


@pytest.mark.parametrize("of", FILES)
def test_every_key_is_described(of: type[Experiment] | type[Campaign]) -> None:
    schema: Any = json_schema(of)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["title"] == f"rig {of.__name__.lower()}"
    undescribed = [key for key, described in properties(schema) if not described.get("description")]
    assert undescribed == []
    assert all(section["additionalProperties"] is False for section in [schema, *schema["$defs"].values()])
