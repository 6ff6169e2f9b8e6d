"""The check of parameters counts plain values, and nothing else."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import check_signatures


@pytest.mark.parametrize(
    ("parameters", "plain"),
    [
        ("self, a: float, b: int | None, c: Path, d: Array, e: NDArray[np.float64], f: np.ndarray", 6),
        ("motor: Motor, wanted: Motor | None, law: Law, watch: Callable[[float], None] | None, *more: float", 0),
        ("a, /, b, *, c: Law, d: bool = True", 3),
    ],
)
def test_plain_values_are_counted(parameters: str, plain: int) -> None:
    function = ast.parse(f"def f({parameters}): ...").body[0]
    assert isinstance(function, ast.FunctionDef)
    assert check_signatures.plain_parameters(function) == plain


def test_too_many_are_told_by_file_and_line_and_a_cured_one_has_to_leave_the_list(tmp_path: Path) -> None:
    file = tmp_path / "crowded.py"
    many = ", ".join(f"p{k}: float" for k in range(7))
    file.write_text(f"class A:\n    def crowded(self, {many}): ...\n\n\ndef cured(a: float): ...\n")
    assert check_signatures.problems(file, set()) == ["2: `A.crowded` takes 7 plain values; a dataclass makes them one"]
    assert check_signatures.problems(file, {"A.crowded"}) == []
    assert "take it off the list" in check_signatures.problems(file, {"A.crowded", "cured"})[0]
