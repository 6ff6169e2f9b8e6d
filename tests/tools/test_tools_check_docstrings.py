"""The check of docstrings finds what is not said."""

from __future__ import annotations

from pathlib import Path

import pytest

import check_docstrings

GOOD = '''
def speed(drive_V: float, gain: float) -> float:
    """Speed under a drive.

    gain   (rad/s)/V, > 0
    Returns rad/s. Raises ValueError where the gain is not > 0.
    """
    if not gain > 0.0:
        raise ValueError("gain")
    return gain * drive_V
'''


@pytest.mark.parametrize(
    ("changed", "to", "words"),
    [
        ("", "", None),
        ("    gain   (rad/s)/V, > 0\n", "", None),
        ("    gain   (", "    gains, gain   (", "no such parameter: gains"),
        (" Raises ValueError where the gain is not > 0.", "", "raises ValueError"),
    ],
)  # fmt: skip
def test_units_names_and_errors_have_to_be_said(changed: str, to: str, words: str | None, tmp_path: Path) -> None:
    file = tmp_path / "speed.py"
    assert changed in GOOD
    file.write_text(GOOD.replace(changed, to) if changed else GOOD)
    found = check_docstrings.problems(file)
    assert found == [] if words is None else words in found[0]


def test_fields_of_a_class_and_the_errors_of_its_making_are_held(tmp_path: Path) -> None:
    file = tmp_path / "motor.py"
    file.write_text(
        'class Motor:\n    """A motor.\n\n    tau_s   time constant, s\n    gone_V  nothing\n    """\n\n'
        "    def __init__(self, tau_s: float) -> None:\n        if tau_s < 0.0:\n            raise ValueError\n"
        '        raise ValueError("tau")\n'
    )
    found = check_docstrings.problems(file)
    assert [line.split(": ", 1)[1] for line in found] == [
        "`Motor`: no such field: gone_V",
        "`Motor.__init__`: raises ValueError, and does not say so",
    ]


@pytest.mark.parametrize(("decorator", "found"), [("", 1), ("    @override\n", 0)])
def test_an_override_may_leave_the_words_to_the_class_above(decorator: str, found: int, tmp_path: Path) -> None:
    file = tmp_path / "motor.py"
    file.write_text(
        f'class Fast(Motor):\n    """A motor."""\n\n{decorator}    def run(self, level: float) -> None: ...\n'
    )
    assert len(check_docstrings.problems(file)) == found
