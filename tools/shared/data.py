"""Data files of the tools: YAML, read strictly into a typed model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from rig.config.messages import explain
from rig.config.problems import ConfigError
from rig.config.yaml12 import parse


class Entry(BaseModel):
    """What a data file holds: it does not change, and has no key that it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


Model = TypeVar("Model", bound=Entry)


def load(path: Path, model: type[Model]) -> Model:
    """What is in a file. Raises ConfigError, with file, line and key, for what the model does not know or allow."""
    document = parse(path.read_text(encoding="utf-8"), str(path))
    try:
        return model.model_validate_json(json.dumps(document.data))  # as JSON: there, strict tuples are lists
    except ValidationError as error:
        raise ConfigError(explain(error.errors(), document, model)) from error
