"""Load an experiment from YAML with errors that name file, line and key; write one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from os import PathLike
from shlex import quote
from typing import Any, TypeVar

from pydantic import ValidationError

from rig.config.campaign import Campaign
from rig.config.messages import explain
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment
from rig.config.yaml12 import MOST_BYTES, Document, emit, parse
from rig.core.plain_file import UnfitError, read_plain
from rig.core.strict_json import JsonObject

Given = str | PathLike[str] | Mapping[str, Any] | Document  # a file, its keys with their values, or what was read of it
IN_PYTHON = "config"  # what a config is called that is in no file

_Schema = TypeVar("_Schema", Experiment, Campaign)


def load(path: Given, *, follows_links: bool = True) -> Experiment:
    """The experiment in a YAML file (UTF-8), or in a mapping with the same keys.

    follows_links  whether the file may be a link: not in a run folder

    Raises ConfigError, and nothing else, if there is none in it.
    What is loaded need not be safe to run: that is ``rig.running.preflight.check``.
    """
    return load_with_places(path, follows_links=follows_links)[0]


def load_with_places(path: Given, *, follows_links: bool = True) -> tuple[Experiment, Document]:
    """``load``, and the file that it came from, which knows the place of each key."""
    document = read(path, follows_links=follows_links)
    return _experiment(document), document


def load_campaign(path: Given) -> Campaign:
    """The campaign in a YAML file (UTF-8). Raises ConfigError, and nothing else, if there is none in it."""
    document = read(path)
    if not _is_campaign(document) and "daq" in document.data:
        problem = Problem(("daq",), "this is one experiment, not a campaign", "run it with `rig run`")
        raise ConfigError([document.located(problem, at_key=True)])
    return _validated(document, Campaign)


def is_campaign(path: Given) -> bool:
    """Whether a file is meant as a campaign: it says how many experiments. Raises ConfigError for what is no YAML."""
    return _is_campaign(read(path))


def dump(config: Experiment | Campaign) -> str:
    """The resolved experiment or campaign, defaults included, as YAML that loads back equal."""
    return emit(config.model_dump(mode="json", exclude_none=True))


def json_schema(of: type[Experiment] | type[Campaign] = Experiment) -> JsonObject:
    """JSON Schema (draft 2020-12) of an experiment or a campaign, for editors."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **of.model_json_schema(),
        "title": f"rig {of.__name__.lower()}",
    }


def schema_text(of: type[Experiment] | type[Campaign] = Experiment) -> str:
    """``json_schema`` as the text of config/schema.json, or of config/campaign-schema.json."""
    return json.dumps(json_schema(of), indent=2, ensure_ascii=False) + "\n"


def read(path: Given, *, follows_links: bool = True, takes_pipe: bool = False) -> Document:
    """The keys of a YAML file with their places, not judged yet. Raises ConfigError for what is no YAML.

    takes_pipe  whether the file may be a pipe, as of ``<(...)``: it is read once, to its end
    """
    if isinstance(path, Document):
        return path
    if isinstance(path, Mapping):
        return Document(IN_PYTHON, dict(path))
    file = str(path)
    try:
        raw = read_plain(path, MOST_BYTES, follows_links=follows_links, takes_pipe=takes_pipe)
    except UnfitError as error:
        raise ConfigError([Problem((), error.cause, error.cure, file)]) from error
    except FileNotFoundError as error:
        cure = f"`rig init {quote(file)}` writes one for your bench; `rig config list` names the ready ones"
        raise ConfigError([Problem((), "no such file", cure, file)]) from error
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise ConfigError([Problem((), f"cannot be read: {error}", "", file)]) from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line, column = before.count(b"\n") + 1, error.start - (before.rfind(b"\n") + 1) + 1
        problem = Problem((), f"not UTF-8: byte 0x{raw[error.start]:02X}", "save the file as UTF-8")
        raise ConfigError([problem.at(file, line, column)]) from error
    document = parse(text, file)
    document.digest, document.text = hashlib.sha256(raw).hexdigest(), raw.decode()
    return document


def _is_campaign(document: Document) -> bool:
    return "experiments" in document.data and "daq" not in document.data


def _experiment(document: Document) -> Experiment:
    if _is_campaign(document):
        problem = Problem(("experiments",), "this is a campaign of many experiments", "run it with `rig campaign`")
        raise ConfigError([document.located(problem, at_key=True)])
    return _validated(document, Experiment)


def _validated(document: Document, schema: type[_Schema]) -> _Schema:
    # as JSON: there, lists are tuples and sections are objects even in strict mode, and "1" is no number
    try:
        text = json.dumps(document.data)
    except (TypeError, ValueError) as error:  # only a program can give such a value
        raise ConfigError([Problem((), f"holds a value that no file can hold: {error}", "", document.file)]) from error
    try:
        return schema.model_validate_json(text, strict=True)
    except ValidationError as error:
        problems = explain(error.errors(include_url=False), document, schema)
        raise ConfigError(problems) from error
