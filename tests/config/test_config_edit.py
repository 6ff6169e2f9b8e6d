"""Values are changed in the text of a config, and nothing else is."""

from __future__ import annotations

import re

import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.config import ready
from rig.config.edit import EditError, Value, changed, with_values
from rig.config.yaml12 import parse

NAMES = sorted(name for name in ready.names() if "campaign" not in name)
LIMITS = ("limits", "soft_rad")
POINTS = ("sensor", "calibration")

numbers = st.floats(-3.0, 3.0).map(lambda x: round(x, 4))
points = st.lists(
    st.fixed_dictionaries({"counts": st.integers(0, 1023), "rad": numbers}), min_size=2, max_size=7
)  # fmt: skip
values = st.fixed_dictionaries(
    {},
    optional={
        POINTS: points,
        LIMITS: st.tuples(numbers, numbers).map(list),
        ("sensor", "linearity_percent"): numbers,
        ("drive", "reversed"): st.booleans(),
        ("drive", "dead_band_duty"): st.fixed_dictionaries({"plus": numbers, "minus": numbers}),
        ("breakaway", "max_V"): numbers,
        ("sensor", "encoder", "sign"): st.sampled_from([1, -1]),
        ("name",): st.sampled_from(["a", "true", "1e3", "it: is"]),
    },
)


def comments(text: str) -> list[str]:
    return [line.split("#", 1)[1] for line in text.splitlines() if "#" in line]


@settings(max_examples=examples(60), deadline=None)
@given(name=st.sampled_from(NAMES), new=values, returns=st.booleans())
def test_any_values_change_nothing_else(name: str, new: dict[tuple[str | int, ...], Value], returns: bool) -> None:
    text = ready.text(name)
    if ("sensor", "calibration") in new and "calibration:" not in text:
        new.pop(("sensor", "calibration"))
    text = text.replace("\n", "\r\n") if returns else text
    before = parse(text, name).data

    edited = with_values(text, new)

    assert parse(edited, name).data == changed(before, new)
    assert comments(edited) == comments(text)
    assert (edited.count("\n") == edited.count("\r\n")) is returns or "\n" not in edited
    touched = {str(path[-1]) for path in new} | {str(path[0]) for path in new} | {"counts", "plus", "encoder"}
    old_lines, new_lines = text.splitlines(), edited.splitlines()
    for line in set(old_lines) - set(new_lines):
        assert any(re.search(rf"\b{key}:", line) for key in touched), line
    assert with_values(edited, new) == edited


@pytest.mark.parametrize(
    ("text", "path", "value", "expected"),
    [
        pytest.param("a: 1.80   # why\n", ("a",), 1.8, "a: 1.80   # why\n", id="the same number stays as written"),
        pytest.param("a: 1   # why\n", ("a",), 12.5, "a: 12.5 # why\n", id="a comment stays in its column"),
        pytest.param("a: [1.0, 2]  # b\n", ("a",), [-1.25, 2], "a: [-1.25, 2] # b\n", id="a comment moves if it must"),
        pytest.param('a: "x # y" # z\n', ("a",), "u", 'a: "u"     # z\n', id="no comment within quotes"),
        pytest.param("a: [1, 2]", ("a",), [3, 4], "a: [3, 4]", id="no line break at the end"),
        pytest.param("s:\n  a: 1 # x\nt: 2\n", ("s", "b"), True, "s:\n  a: 1 # x\n  b: true\nt: 2\n", id="a new key"),
        pytest.param("s: {a: 1}\n", ("s", "b"), 2, "s: {a: 1, b: 2}\n", id="a new key in braces"),
        pytest.param("t: 2", ("s", "b"), 2, "t: 2\ns:\n  b: 2", id="a new section"),
        pytest.param("s:   # empty\nt: 1\n", ("s", "b"), 2, "s: {b: 2}   # empty\nt: 1\n", id="an empty section"),
        pytest.param(
            "p:\n- {c: 1} # one\n# between\n- {c: 2} # two\nt: 1\n", ("p",), [{"c": 3}],
            "p:\n- {c: 3} # one\n# between\nt: 1\n", id="a list gets shorter",
        ),
        pytest.param(
            "p:\n  - c: 1 # one\n    r: 0.5\n\nt: 1\n", ("p",), [{"c": 3, "r": 1.5}, {"c": 4, "r": 2.5}],
            "p:\n  - c: 3 # one\n    r: 1.5\n  - {c: 4, r: 2.5}\n\nt: 1\n", id="a list gets longer",
        ),
    ],
)  # fmt: skip
def test_the_text_keeps_its_shape(text: str, path: tuple[str, ...], value: Value, expected: str) -> None:
    assert with_values(text, {path: value}) == expected


def test_a_comment_that_would_be_lost_is_refused() -> None:
    with pytest.raises(EditError, match="comments between its brackets"):
        with_values("p: [1, # one\n    2]\n", {("p",): [1, 2, 3]})
