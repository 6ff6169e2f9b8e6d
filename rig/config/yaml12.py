"""YAML with the scalars of YAML 1.2's core schema, and the place of everything in the file.

PyYAML reads YAML 1.1: ``1e-3`` is text, ``on`` is true, ``010`` is 8, and the last of two equal keys wins. Here
``1e-3`` and ``010`` are numbers, ``on`` is text, and equal keys are an error. Anchors, aliases, merge keys and tags are
errors too: people read an experiment, so each number stands where it is used.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml

from rig.config.problems import ConfigError, Path, Problem, printable
from rig.core.strict_json import JsonObject

if TYPE_CHECKING:  # it loads slowly
    from pydantic import JsonValue


MOST_BYTES = 2**20  # of a config; ours have some thousands
_DEEPEST = 20  # sections within sections; the schema needs 5
_MOST_VALUES = 10_000  # keys among them; a config has some hundreds
_LONGEST_NUMBER = 40  # characters

_NULL, _BOOL, _INT, _FLOAT, _STR = (f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str"))

# YAML 1.2.2, section 10.3.2 (core schema), in the order in which they are tried
_CORE_SCHEMA = [
    (_NULL, re.compile(r"(?:null|Null|NULL|~|)\Z")),
    (_BOOL, re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")),
    (_INT, re.compile(r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)\Z")),
    (
        _FLOAT,
        re.compile(
            r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
            r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"
        ),
    ),
]

_HINTS = [  # part of PyYAML's message -> what people have usually done; whether its cause is where the construct begins
    ("mapping values are not allowed", "check the indentation, and quote a text that contains `: `", False),
    ("could not find expected ':'", "write `key: value`, with a space after the colon", True),
    ("expected <block end>", "keys of one section must start in the same column", False),
    ("expected ',' or", "the bracket or brace that begins here is not closed, or a comma is missing", True),
    ("found unexpected end of stream", "the quote that begins here is not closed", True),
    ("sequence entries are not allowed here", "put the list's first `-` on a line of its own", False),
]


class _Loader(yaml.SafeLoader):
    """Composes nodes; refuses YAML features that an experiment does not need."""

    yaml_implicit_resolvers = {None: _CORE_SCHEMA}  # noqa: RUF012 (PyYAML's own attribute)

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._values = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refused(mark, "anchors and aliases are not supported: write the value where it is used")
        if getattr(event, "tag", None) is not None:
            raise _refused(mark, "tags (`!...`) are not supported: write the plain value")
        if self._depth >= _DEEPEST:
            raise _refused(mark, f"nested more than {_DEEPEST} levels deep")
        self._values += 1
        if self._values > _MOST_VALUES:
            raise _refused(mark, f"more than {_MOST_VALUES} keys and values")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes a text exactly where this module would read it as something else."""

    yaml_implicit_resolvers = {None: _CORE_SCHEMA}  # noqa: RUF012 (PyYAML's own attribute)


def _refused(mark: yaml.Mark, message: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=message, problem_mark=mark)


@dataclass
class Document:
    """One file: its plain values (dict, list, str, bool, int, float, None) and where they stand.

    A place is (line, column), from 1.
    digest  SHA-256 of the file's bytes; "" of what is no file
    text    of the file, with its own line breaks and its byte order mark
    """

    file: str
    data: JsonObject = field(default_factory=dict)
    digest: str = ""
    text: str = ""
    _keys: dict[Path, tuple[int, int]] = field(default_factory=dict)
    _values: dict[Path, tuple[int, int]] = field(default_factory=dict)

    def located(self, problem: Problem, *, at_key: bool = False) -> Problem:
        """``problem`` with its place: of the value, or of the key; of the section around it if it is not there."""
        path = problem.path
        if path in self._values and not at_key:
            return problem.at(self.file, *self._values[path])
        while path and path not in self._keys:
            path = path[:-1]
        top = (1, 1) if self._values else (0, 0)  # what a program gives is in no line
        return problem.at(self.file, *self._keys.get(path, top))


def parse(text: str, file: str) -> Document:
    """Read one document whose top is a mapping.

    Raises ConfigError, with places, for anything else: bad syntax, several documents, keys given twice or not
    names, anchors, tags, numbers that are not finite, text that is not Unicode, what is nested too deeply or too much.
    """
    node = compose(text, file)
    document = Document(file)
    if node is None:
        raise ConfigError([Problem((), "the file is empty", "start from config/demo.yaml").at(file, 1, 1)])
    if not isinstance(node, yaml.MappingNode):
        what = "a list" if isinstance(node, yaml.SequenceNode) else "a single value"
        problem = Problem((), f"the file must hold keys with values, not {what}", "start from config/demo.yaml")
        raise ConfigError([problem.at(file, *_place(node.start_mark))])
    problems: list[Problem] = []
    data = _build(node, (), document, problems)
    assert isinstance(data, dict)
    document.data = data
    if problems:
        raise ConfigError(problems)
    return document


def emit(data: JsonObject) -> str:
    """Plain values as YAML that ``parse`` reads back equal."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)


def compose(text: str, file: str) -> yaml.Node | None:
    """The document's root node, None if there is none; ConfigError for bad syntax, and for what is too much."""
    if len(text) > MOST_BYTES:
        raise ConfigError([Problem((), f"more than {MOST_BYTES} characters", "leave out what is no experiment", file)])
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_node()
        finally:
            loader.dispose()
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        place = before.count("\n") + 1, error.position - (before.rfind("\n") + 1) + 1
        problem = Problem((), f"control character U+{ord(text[error.position]):04X}", "delete it")
        raise ConfigError([problem.at(file, *place)]) from error
    except yaml.MarkedYAMLError as error:
        raise ConfigError([_syntax(error, file)]) from error
    except (ValueError, OverflowError) as error:  # PyYAML on `"\Uffffffff"` and the like
        problem = Problem((), f"not valid YAML: {printable(str(error))}", "check escapes in quoted text")
        raise ConfigError([problem.at(file, 1, 1)]) from error


def _syntax(error: yaml.MarkedYAMLError, file: str) -> Problem:
    """PyYAML's error, rewritten for people."""
    text = error.problem or error.context or "cannot be read"
    message, hint, mark = f"not valid YAML: {printable(text)}", "", error.problem_mark
    if type(error) is yaml.MarkedYAMLError:  # one of ours
        message = text
    elif "expected a single document" in (error.context or ""):
        message, hint = "a second document begins here", "one experiment a file: remove the `---`"
    elif "'\\t'" in text:
        message, hint = "a tab where spaces must be", "indent with spaces"
    else:
        for part, way_out, at_start in _HINTS:
            if part in text:
                hint = way_out
                mark = error.context_mark if at_start else mark
                break
    return Problem((), message, hint).at(file, *(_place(mark) if mark is not None else (1, 1)))


def _build(node: yaml.Node, path: Path, document: Document, problems: list[Problem]) -> JsonValue:
    """Plain value of a node; what is wrong goes to ``problems``, places to ``document``."""
    document._values[path] = _place(node.start_mark)
    if isinstance(node, yaml.MappingNode):
        section: JsonObject = {}
        for key_node, value_node in node.value:
            place = _place(key_node.start_mark)
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag != _STR or _unencodable(key_node.value):
                what = printable(key_node.value) if isinstance(key_node, yaml.ScalarNode) else "a list or section"
                problem = Problem(path, f"a key must be a name, not {what or 'nothing'}")
                problems.append(problem.at(document.file, *place))
                continue
            inner = (*path, key_node.value)
            if key_node.value in section:
                first = document._keys[inner][0]
                problem = Problem(inner, f"given twice: first in line {first}, again in line {place[0]}", "keep one")
                problems.append(problem.at(document.file, *place))
                continue
            document._keys[inner] = place
            section[key_node.value] = _build(value_node, inner, document, problems)
        return section
    if isinstance(node, yaml.SequenceNode):
        items: list[JsonValue] = []
        for index, item in enumerate(node.value):
            document._keys[(*path, index)] = _place(item.start_mark)
            items.append(_build(item, (*path, index), document, problems))
        return items
    try:
        return _scalar(node.tag, node.value)
    except ValueError as error:
        problems.append(document.located(Problem(path, str(error))))
        return None


def _scalar(tag: str, text: str) -> str | bool | int | float | None:
    """Value of a scalar whose tag the core schema has found; ValueError, for people, if it cannot be used."""
    if tag == _NULL:
        return None
    if tag == _BOOL:
        return text.lower() == "true"
    if tag == _STR:
        if _unencodable(text):
            raise ValueError("the text holds half of a surrogate pair, which is no character")
        return text
    if len(text) > _LONGEST_NUMBER:
        raise ValueError(f"a number of {len(text)} characters; {_LONGEST_NUMBER} are enough")
    if tag == _INT:
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    if text.lstrip("+-").lower() in (".inf", ".nan"):
        raise ValueError(f"must be a finite number, not {text}")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too large for a number")
    return value


def _unencodable(text: str) -> bool:
    return any("\ud800" <= c <= "\udfff" for c in text)


def _place(mark: yaml.Mark) -> tuple[int, int]:
    return mark.line + 1, mark.column + 1
