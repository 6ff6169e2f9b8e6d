"""The stages of a run: what a name says, and that any name is one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.run_folder.recording.stage import Stage, StageKind


@pytest.mark.parametrize(
    ("name", "kind", "number", "method"),
    [
        ("rest", StageKind.REST, None, ""),
        ("breakaway", StageKind.BREAKAWAY, None, ""),
        ("relay-2", StageKind.RELAY, 2, ""),
        ("strokes-3", StageKind.STROKES, 3, ""),
        ("strokes", StageKind.OTHER, None, ""),
        ("hysteretic-12", StageKind.HYSTERETIC, 12, ""),
        ("track:sampled-data", StageKind.TRACK, None, "sampled-data"),
        ("relay-a", StageKind.RELAY, None, ""),
        ("stopping", StageKind.STOPPING, None, ""),
        ("law", StageKind.LAW, None, ""),
        ("relay", StageKind.OTHER, None, ""),
        ("other", StageKind.OTHER, None, ""),
        ("", StageKind.OTHER, None, ""),
    ],
)
def test_a_name_says_what_is_done(name: str, kind: StageKind, number: int | None, method: str) -> None:
    assert Stage.parse(name) == Stage(name, kind, number, method)


@given(st.text())
def test_any_name_is_a_stage_and_stays_its_name(name: str) -> None:
    assert str(Stage.parse(name)) == name


@given(st.integers(1, 99), st.text())
def test_what_is_built_is_what_is_parsed(number: int, method: str) -> None:
    for stage in (
        Stage.test(StageKind.RELAY, number),
        Stage.test(StageKind.STROKES, number),
        Stage.test(StageKind.HYSTERETIC, number),
        Stage.track(method),
    ):
        assert Stage.parse(str(stage)) == stage


def test_tests_are_those_of_either_relay_and_strokes() -> None:
    names = ("rest", "relay-1", "search", "strokes-1", "hysteretic-2", "track:x")
    assert [name for name in names if Stage.parse(name).is_test] == ["relay-1", "strokes-1", "hysteretic-2"]
