"""Makes a typed part from the data of a file: strictly, or without what is wrong in it. Opens no file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from rig.core.signals import plain
from rig.run_folder.results.meta import RunMeta
from rig.run_folder.results.part import VERSION, Part
from rig.run_folder.results.result import RunResult

_P = TypeVar("_P", bound=Part)
_Path = tuple[int | str, ...]

_MOST_SAID = 20

_MUST_BE = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "dict_type": "an object with keys",
    "model_type": "an object with keys",
    "finite_number": "a number that is finite",
}


class DamagedError(Exception):
    """A file holds something wrong.

    key, cause  the first key that is wrong, with dots, and what is wrong with it
    """

    def __init__(self, key: str, cause: str) -> None:
        self.key = key
        self.cause = cause
        super().__init__(cause)


def parsed(kind: type[_P], data: Mapping[str, Any]) -> _P:
    """The part that a JSON object describes. Raises DamagedError for the first key that is wrong."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise DamagedError(_key(first["loc"]), _in_words(first)) from error


def salvaged(kind: type[_P], data: Mapping[str, Any]) -> tuple[_P, list[str]]:
    """The part that a JSON object describes, without what is wrong; and a sentence for each piece left out.

    Of very many pieces the last sentence says how many more there are.
    """
    kept: Any = data
    left_out: list[str] = []
    while True:
        try:
            return kind.model_validate(kept), _first(left_out, "{} more values are wrong")
        except ValidationError as error:
            found = error.errors(include_url=False)
        if not left_out:
            kept = json.loads(json.dumps(data))  # pieces are taken out of a copy
        wrong: dict[_Path, str] = {}  # each piece to leave out, and the first thing that is wrong with it
        for one in found:
            wrong.setdefault(_innermost(kept, one["loc"]), _in_words(one))
        left_out += wrong.values()
        # from the end, so that what stands before keeps its place in a list
        for path in sorted(wrong, key=_order, reverse=True):
            kept = _without(kept, path)


def unknown_keys(part: Part) -> tuple[str, ...]:
    """The keys of a part, with dots, that this version does not know."""
    return tuple(_unknown(part, ""))


def remarks(file: RunMeta | RunResult) -> list[str]:
    """Notes on a file that was read: a newer version wrote it; this version does not know some of its keys."""
    notes = []
    if file.version > VERSION:
        notes.append(f"a newer version of rig wrote it (schema {file.version}; this one knows {VERSION})")
    keys = unknown_keys(file)
    if keys:
        notes.append(
            f"not known to this version of rig, and not used: {', '.join(_first(list(map(plain, keys)), '{} more'))}"
        )
    return notes


def _first(words: list[str], rest: str) -> list[str]:
    """At most ``_MOST_SAID`` of them, and how many more there are."""
    more = len(words) - _MOST_SAID
    return words if more <= 0 else [*words[:_MOST_SAID], rest.format(more)]


def _unknown(value: object, at: str) -> Iterator[str]:
    if isinstance(value, BaseModel):
        yield from (_below(at, name) for name in value.model_extra or {})
        for name, field in type(value).model_fields.items():
            yield from _unknown(getattr(value, name), _below(at, field.alias or name))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _unknown(item, _below(at, str(key)))
    elif isinstance(value, tuple):
        for number, item in enumerate(value):
            yield from _unknown(item, f"{at}[{number}]")


def _below(at: str, key: str) -> str:
    return f"{at}.{key}" if at else key


def _key(path: _Path) -> str:
    text = ""
    for part in path:
        text = f"{text}[{part}]" if isinstance(part, int) else _below(text, part)
    return plain(text)


def _in_words(error: ErrorDetails) -> str:
    """An error of pydantic for people: the key, what it must be, what it is."""
    key, kind, value = _key(error["loc"]), error["type"], error["input"]
    if kind == "missing":
        return f"{key} is missing"
    if kind == "literal_error":
        return f"{key} must be one of {error['ctx']['expected']}, not {_described(value)}"
    if kind in ("greater_than", "greater_than_equal"):
        bound = "greater than" if kind == "greater_than" else "at least"
        return f"{key} must be {bound} {error['ctx'].get('gt', error['ctx'].get('ge')):g}, not {_described(value)}"
    wanted = _MUST_BE.get(kind)
    if kind == "model_type":
        return f"{key} must be {wanted}: {_described(value)} is no {key.rpartition('.')[2]}"
    return f"{key} must be {wanted}, not {_described(value)}" if wanted else f"{key}: {error['msg']}"


def _described(value: object) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case str():
            return f"the text {plain(repr(value if len(value) <= 60 else value[:57] + '...'))}"
        case list() | tuple():
            return f"a list of {len(value)}"
        case Mapping():
            return "an object"
    return str(value)[:60]


def _innermost(data: Any, path: _Path) -> _Path:
    """As much of a path as the data has: if a key is missing, the object that lacks it is at fault."""
    there: list[int | str] = []
    for part in path:
        is_there = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        if not is_there:
            break
        data = data[part]
        there.append(part)
    return tuple(there)


def _order(path: _Path) -> list[tuple[int, int | str]]:
    return [(0, part) if isinstance(part, int) else (1, part) for part in path]


def _without(data: Any, path: Sequence[int | str]) -> Any:
    """The data without the piece at a path; empty if the path is ()."""
    if not path:
        return {}
    *above, last = path
    holder = data
    for part in above:
        holder = holder[part]
    del holder[last]
    return data
