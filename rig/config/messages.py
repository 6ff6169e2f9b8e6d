"""Pydantic's errors, rewritten for people: the key, what it must be, what it is, what to do."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from rig.config.bridges import of_module
from rig.config.problems import Path, Problem, key_of, printable
from rig.config.schema import Bridge, Experiment
from rig.config.units import converted, stem_of, unit_of
from rig.config.yaml12 import Document

_COMPARISONS = {
    "greater_than": ("greater than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
_NAME = "lower-case letters, digits, - and _, beginning with a letter or digit"


def explain(errors: Iterable[ErrorDetails], document: Document, schema: type[BaseModel] = Experiment) -> list[Problem]:
    """Problems with their places, in the order of the file. A mistyped key is one problem, not also a missing key."""
    found = [document.located(problem, at_key=at_key) for problem, at_key in _found(errors, schema)]
    unique = {(problem.path, problem.message): problem for problem in found}
    return sorted(unique.values(), key=lambda problem: (problem.line, problem.column))


def unplaced(errors: Iterable[ErrorDetails], schema: type[BaseModel], above: Path) -> list[Problem]:
    """Problems of a section that stands at ``above``, without their places."""
    found = [problem for problem, _ in _found(errors, schema)]
    unique = {(problem.path, problem.message): problem for problem in found}
    return [replace(problem, path=(*above, *problem.path)) for problem in unique.values()]


def _found(errors: Iterable[ErrorDetails], schema: type[BaseModel]) -> Iterator[tuple[Problem, bool]]:
    """Each problem, and whether the key is wrong instead of its value."""
    mistyped: set[Path] = set()
    missing: list[Problem] = []
    for error in errors:
        path = error["loc"]
        if error["type"] == "extra_forbidden":
            wanted, hint = _meant(path, error["input"], schema)
            mistyped.add(wanted)
            yield Problem(path, "unknown key", hint), True
        elif error["type"] == "missing" and isinstance(path[-1], str):
            missing.append(_missing(path, schema))
        elif (problem := _invalid(path, error, schema)) is not None:
            yield problem, False
    yield from ((problem, False) for problem in missing if problem.path not in mistyped)


def _missing(path: Path, schema: type[BaseModel]) -> Problem:
    key = str(path[-1])
    section = _section(path[:-1], schema)
    described = section.model_fields[key].description if section and key in section.model_fields else None
    unit = unit_of(key)
    about = ", ".join(part for part in (described, unit and f"in {unit}") if part)
    return Problem(path, "required key is missing", f"add it: {about}" if about else "add it")


def _meant(path: Path, value: object, schema: type[BaseModel]) -> tuple[Path, str]:
    """The key that an unknown one probably means, () if there is none; and the hint."""
    *above, last = path
    key = str(last)
    section = _section(path[:-1], schema)
    here = list(section.model_fields) if section else []
    for known in here:
        if stem_of(known) == stem_of(key):
            notes = ", ".join(part for part in (unit_of(known), converted(value, key, known)) if part)
            return (*above, known), f"did you mean '{known}'?" + (f" ({notes})" if notes else "")
    elsewhere = [known for known in _all_keys(schema) if known[-1] == key]
    if elsewhere:
        return elsewhere[0], f"did you mean '{key_of(elsewhere[0])}'? it belongs in another section"
    if close := difflib.get_close_matches(key, here, n=1):
        return (*above, close[0]), f"did you mean '{close[0]}'?"
    return (), f"known here: {', '.join(here)}"


def _invalid(path: Path, error: ErrorDetails, schema: type[BaseModel]) -> Problem | None:
    """The problem of a wrong value; None where another error in the list describes it better."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    unit = unit_of(key)
    in_unit = f" in {unit}" if unit else ""
    got = f"got {_described(value)}"
    if kind in _COMPARISONS:
        words, bound = _COMPARISONS[kind]
        return Problem(path, f"must be {words} {context[bound]:g}{f' {unit}' if unit else ''}, {got}")
    if kind == "literal_error":
        choices = re.findall(r"'([^']*)'", context["expected"])
        close = difflib.get_close_matches(str(value), choices, n=1)
        hint = f"did you mean '{close[0]}'?" if close else ""
        if choices == list(get_args(Bridge)):
            hint = of_module(str(value)) or hint
        return Problem(path, f"must be one of {', '.join(choices)}, {got}", hint)
    if kind == "missing":  # an element of a pair
        return Problem(path[:-1], f"must be two values, [low, high], {got}")
    if kind == "too_short" and len(value) >= context["min_length"]:
        return None  # its elements are wrong, which is said
    if kind == "value_error":
        return Problem(path, str(context["error"]))
    known = {
        "float_type": (f"must be a number{in_unit}", _number_hint(value, unit)),
        "int_type": (f"must be a whole number{in_unit}", _number_hint(value, unit)),
        "bool_type": ("must be true or false", "`yes` and `on` are plain text: write true or false"),
        "string_type": ("must be text", "put it in quotes" if isinstance(value, bool | int | float) else ""),
        "model_type": ("must be a section with keys of its own", _keys_hint(path, schema)),
        "tuple_type": ("must be a list", "write [a, b]"),
        "too_short": (f"must hold at least {context.get('min_length')} items", ""),
        "too_long": (f"must hold at most {context.get('max_length')} items", ""),
        "string_pattern_mismatch": (f"must be made of {_NAME}", ""),
        "string_too_long": (f"must be at most {context.get('max_length')} characters", ""),
    }
    words, hint = known.get(kind, (error["msg"].replace("Input should be", "must be"), ""))
    return Problem(path, f"{words}, {got}", hint)


def _number_hint(value: object, unit: str) -> str:
    """What to write instead of a value that is no number."""
    if isinstance(value, float):
        return "without a decimal point"
    if not isinstance(value, str):
        return ""
    if re.fullmatch(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?", value):
        return "leave out the quotes"
    if re.fullmatch(r"[-+]?[0-9.]+\s*[A-Za-zµ/%]+", value):
        return f"write the number alone; it is in {unit}" if unit else "write the number alone"
    if re.fullmatch(r"[-+]?[0-9]+,[0-9]+", value):
        return "write a decimal point, not a comma"
    if re.fullmatch(r"[-+]?[0-9_]+", value):
        return "without underscores"
    return ""


def _keys_hint(path: Path, schema: type[BaseModel]) -> str:
    section = _section(path, schema)
    return f"its keys: {', '.join(section.model_fields)}" if section else ""


def _described(value: object) -> str:
    """A value in a few words."""
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case str():
            return f"the text {json.dumps(printable(value), ensure_ascii=False)}"
        case list() | tuple():
            return f"a list of {len(value)}"
        case dict():
            return "a section"
    return str(value)


def _section(path: Path, schema: type[BaseModel]) -> type[BaseModel] | None:
    """The schema's section at a path; None if there is none."""
    section: type[BaseModel] | None = schema
    for part in path:
        if isinstance(part, str):
            if section is None or part not in section.model_fields:
                return None
            section = _model_in(section.model_fields[part].annotation)
    return section


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The section in a type, also if it is optional or in a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for inner in get_args(annotation) if (model := _model_in(inner))), None)


def _all_keys(section: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every key of the schema, as a path without list indices."""
    for key, info in section.model_fields.items():
        yield (*above, key)
        if inner := _model_in(info.annotation):
            yield from _all_keys(inner, (*above, key))
