"""The JSON Schemas of meta.json and result.json, made from the models."""

from __future__ import annotations

import json
from typing import Final

from rig.run_folder.results.meta import RunMeta
from rig.run_folder.results.part import Part
from rig.run_folder.results.result import RunResult

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema_text(of: type[Part]) -> str:
    """JSON Schema (draft 2020-12) of a file of this version, as text; ``of``: RunMeta or RunResult."""
    titles = {RunMeta: "meta.json of a run of rig", RunResult: "result.json of a run of rig"}
    schema = {"$schema": DIALECT, **of.model_json_schema(), "title": titles.get(of, of.__name__)}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
