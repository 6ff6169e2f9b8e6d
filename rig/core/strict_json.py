"""Reads JSON that somebody else may have written: strictly, and with bounds on what it may cost.

``json.loads`` alone takes NaN, the last of two equal keys, half of a surrogate pair and a number that becomes infinite;
it ends in a RecursionError for what is nested deeply.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:  # it loads slowly, and whoever follows a run has no other use for it
    from pydantic import JsonValue

    JsonObject = dict[str, JsonValue]
else:
    JsonObject = dict

MOST_LEVELS: Final = 40  # lists and objects within each other; a result has 7
MOST_VALUES: Final = 50_000  # of one text; a result has some hundreds
MOST_DIGITS: Final = 40  # characters of a whole number

# one after the other, so that no text takes long: no part of it can be matched in two ways
_STRING: Final = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
_BRACKET: Final = re.compile(r"[\[\]{}]")
_HALF_PAIR: Final = re.compile(r"\\u[dD][89a-fA-F]")
_SHOWN: Final = 40  # characters of what is wrong


class JsonError(ValueError):
    """What is wrong with a text that should be JSON, for people.

    line  in the text, from 1; None: not known
    """

    def __init__(self, words: str, line: int | None = None) -> None:
        self.line = line
        super().__init__(words)


def parse(text: str, most_values: int = MOST_VALUES) -> JsonValue:
    """The value that a text of JSON, of at most so many values, describes. Raises JsonError, and nothing else."""
    _require_bounded(text, most_values)
    try:
        value: JsonValue = json.loads(
            text, parse_int=_integer, parse_float=_number, parse_constant=_number, object_pairs_hook=_object
        )
    except json.JSONDecodeError as error:
        raise JsonError(str(error), error.lineno) from error
    except _WrongError as error:
        raise JsonError(error.words, _line_of(text, error.literal)) from error
    if _HALF_PAIR.search(text):
        try:
            json.dumps(value, ensure_ascii=False).encode("utf-8")
        except UnicodeEncodeError as error:
            raise JsonError("a text holds half of a surrogate pair, which is no character") from error
    return value


class _WrongError(Exception):
    """A literal of the text that is refused."""

    def __init__(self, literal: str, words: str) -> None:
        self.literal, self.words = literal, words


def _require_bounded(text: str, most_values: int) -> None:
    opened = text.count("[") + text.count("{")
    if opened <= MOST_LEVELS and opened + text.count(",") <= most_values:
        return  # whatever stands within strings
    bare = _STRING.sub("", text)
    if bare.count("[") + bare.count("{") + bare.count(",") > most_values:
        raise JsonError(f"it holds more than {most_values} values")
    level = 0
    for bracket in _BRACKET.finditer(bare):
        level += 1 if bracket[0] in "[{" else -1
        if level > MOST_LEVELS:
            line = 1 + bare.count("\n", 0, bracket.start())  # no string of JSON has a line end
            raise JsonError(f"it is nested more than {MOST_LEVELS} levels deep", line)


def _integer(literal: str) -> int:
    if len(literal) > MOST_DIGITS:
        raise _WrongError(literal, f"a number has {len(literal)} digits; {MOST_DIGITS} are enough")
    return int(literal)


def _number(literal: str) -> float:
    value = float(literal) if literal[-1].isdigit() else math.nan
    if math.isnan(value):
        raise _WrongError(literal, f"{literal} is no JSON number")
    if math.isinf(value):
        raise _WrongError(literal, f"{literal[:_SHOWN]} is too large for a number")
    return value


def _object(pairs: list[tuple[str, JsonValue]]) -> dict[str, JsonValue]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = sorted(key for key, _ in pairs)
        twice = next(key for key, following in itertools.pairwise(keys) if key == following)
        raise _WrongError(json.dumps(twice), f"the key {json.dumps(twice[:_SHOWN])} is given twice")
    return found


def _line_of(text: str, literal: str) -> int | None:
    """The line where this stands, the last one of several."""
    at = text.rfind(literal)
    return None if at < 0 else 1 + text.count("\n", 0, at)
