"""Changes values in the text of a config. Comments, order, spaces and every other key stay as they are.

The places come from the YAML parser. The result is parsed again: it must say what was asked for, and nothing else.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from rig.config.problems import Path, key_of
from rig.config.yaml12 import compose, parse
from rig.core.errors import CauseError
from rig.core.strict_json import JsonObject

Value = bool | int | float | str | Sequence["Value"] | Mapping[str, "Value"]

_COMMENT = re.compile(r"(?:^|\s)#", re.MULTILINE)
_PLAIN = re.compile(r"[A-Za-z/][A-Za-z0-9/_.-]*")  # text that needs no quotes, but for words that mean something else
_OTHERS = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")
_COMMENT_BEHIND = re.compile(r"([ ]+)(#)")


class EditError(CauseError):
    """A value that cannot be changed without touching something else."""


def with_values(text: str, values: Mapping[Path, Value]) -> str:
    """The text of a config, with these values. A key or a section that is missing is added.

    A list that gets shorter loses the lines of its last items, with the comments on those lines.
    Raises ConfigError for a text that is no config, EditError where a comment inside brackets would be lost.
    """
    wanted = changed(parse(text, "config").data, values)
    for path, value in values.items():
        text = _with_value(text, path, value)
    if parse(text, "config").data != wanted:
        raise EditError(
            f"{', '.join(key_of(path) for path in values)} cannot be changed in this file as it is written",
            "write these sections with one key a line, as `rig init` does; or put the values in by hand",
        )
    return text


def changed(data: JsonObject, values: Mapping[Path, Value]) -> JsonObject:
    """The keys of a config, with these values."""
    new = copy.deepcopy(data)
    for path, value in values.items():
        section: Any = new
        for key in path[:-1]:
            if section.get(key) is None:
                section[key] = {}
            section = section[key]
        section[path[-1]] = _plain(value)
    return new


def _plain(value: Value) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    return value


def _with_value(text: str, path: Path, value: Value) -> str:
    node = compose(text, "config")
    for depth, key in enumerate(path):
        if not isinstance(node, yaml.MappingNode):
            raise EditError(f"{key_of(path[:depth])} is no section", "write it as keys with values")
        found = next(((k, v) for k, v in node.value if k.value == key), None)
        if found is None:
            missing: Value = value
            for inner in reversed(path[depth + 1 :]):
                missing = {str(inner): missing}
            return _inserted(text, node, str(key), missing)
        key_node, node = found
        if node.start_mark.index == node.end_mark.index:  # `key:` with nothing behind it
            at = text.index(":", key_node.end_mark.index) + 1
            for inner in reversed(path[depth + 1 :]):
                value = {str(inner): value}
            return f"{text[:at]} {_flow(value)}{text[at:]}"
    assert node is not None
    return _replaced(text, node, value)


def _replaced(text: str, node: yaml.Node, value: Value) -> str:
    """The text with ``value`` where ``node`` stands."""
    if _is_on_one_line(node):
        start, end = node.start_mark.index, node.end_mark.index
        old = text[start:end]
        if json.dumps(parse(f"v: {old}", "config").data["v"]) == json.dumps(_plain(value)):
            return text  # `1.80` may stay as it is
        stays_quoted = isinstance(value, str) and old.startswith(('"', "'"))
        return _overwritten(text, start, end, _quoted(value) if stays_quoted else _flow(value))
    if isinstance(node, yaml.SequenceNode) and isinstance(value, Sequence) and not isinstance(value, str):
        if len(node.value) == len(value):
            for item, inner in reversed(list(zip(node.value, value, strict=True))):
                text = _replaced(text, item, inner)
            return text
        if not node.flow_style:
            return _resized(text, node, value)
    if isinstance(node, yaml.MappingNode) and isinstance(value, Mapping):
        own = {key.value: inner for key, inner in node.value}
        if own.keys() == value.keys():
            for key, inner in reversed(own.items()):
                text = _replaced(text, inner, value[key])
            return text
    return _overwritten(text, node.start_mark.index, _end(node), _flow(value))


def _is_on_one_line(node: yaml.Node) -> bool:
    """Whether it is a value, or brackets, that begins and ends in the same line: no comment can be inside."""
    is_flow = not isinstance(node, yaml.CollectionNode) or bool(node.flow_style)
    return is_flow and bool(node.start_mark.line == node.end_mark.line)


def _overwritten(text: str, start: int, end: int, new: str) -> str:
    """The text with ``new`` from start to end. A comment behind it stays in its column, if it can."""
    old = text[start:end]
    if "\n" in old and _COMMENT.search(old):
        raise EditError(
            f"the value {old.splitlines()[0].strip()} ... has comments between its brackets",
            "write it with one item a line, each behind a `- `",
        )
    behind = _COMMENT_BEHIND.match(text, end)
    if behind is None or "\n" in old:
        return text[:start] + new + text[end:]
    blanks = max(1, len(behind[1]) + len(old) - len(new))
    return text[:start] + new + " " * blanks + text[behind.start(2) :]


def _resized(text: str, node: yaml.SequenceNode, value: Sequence[Value]) -> str:
    """The text with a block list that has more or fewer items than before, a line each."""
    kept = min(len(node.value), len(value))
    if kept == 0:
        return _overwritten(text, node.start_mark.index, _end(node), _flow(value))
    if len(value) > kept:
        at = _line_end(text, _end(node.value[-1]))
        indent = " " * node.start_mark.column
        lines = "".join(f"{_newline(text)}{indent}- {_flow(item)}" for item in value[kept:])
        text = text[:at] + lines + text[at:]
    for item in reversed(node.value[kept:]):
        start = _line_end(text, text.rindex("\n", 0, item.start_mark.index))
        text = text[:start] + text[_line_end(text, _end(item)) :]
    for item, inner in reversed(list(zip(node.value[:kept], value[:kept], strict=True))):
        text = _replaced(text, item, inner)
    return text


def _inserted(text: str, section: yaml.MappingNode, key: str, value: Value) -> str:
    """The text with one more key at the end of a section."""
    if section.flow_style:
        if not section.value:
            at = section.start_mark.index + 1
            return f"{text[:at]}{key}: {_flow(value)}{text[at:]}"
        at = _end(section.value[-1][1]) if section.value[-1][1].value != "" else section.end_mark.index - 1
        return f"{text[:at]}, {key}: {_flow(value)}{text[at:]}"
    newline, indent = _newline(text), " " * section.start_mark.column
    last_key, last = section.value[-1]
    is_empty = last.start_mark.index == last.end_mark.index
    end = text.index(":", last_key.end_mark.index) + 1 if is_empty else _end(last)
    if text[end - 1] == "\n":  # behind a text of several lines
        end -= 1
    at = _line_end(text, end)
    if isinstance(value, Sequence) and not isinstance(value, str) and value and isinstance(value[0], Mapping):
        lines = "".join(f"{newline}{indent}  - {_flow(item)}" for item in value)
    elif isinstance(value, Mapping) and indent == "":
        lines = "".join(f"{newline}  {inner}: {_flow(item)}" for inner, item in value.items())
    else:
        lines = f" {_flow(value)}"
    return f"{text[:at]}{newline}{indent}{key}:{lines}{text[at:]}"


def _end(node: yaml.Node) -> int:
    """Where a value ends; the parser lets a block end where the next key begins."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        key, inner = last if isinstance(last, tuple) else (None, last)
        if key is not None and inner.start_mark.index == inner.end_mark.index:
            return int(key.end_mark.index) + 1
        return _end(inner)
    return int(node.end_mark.index)


def _line_end(text: str, index: int) -> int:
    """End of the line, before its line break; a carriage return belongs to the break."""
    end = text.find("\n", index)
    end = len(text) if end < 0 else end
    return end - 1 if text[max(end - 1, 0) : end] == "\r" else end


def _newline(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def _quoted(value: Value) -> str:
    return json.dumps(value, ensure_ascii=False)


def _flow(value: Value) -> str:
    """A value on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return value if _PLAIN.fullmatch(value) and value.lower() not in _OTHERS else _quoted(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(inner)}" for key, inner in value.items()) + "}"
    return "[" + ", ".join(_flow(inner) for inner in value) + "]"
