"""The check of the documents: the theory that the code cites, links to headings, and the figures of the pages."""

from __future__ import annotations

from pathlib import Path

import pytest

import check_docs
import figures
from check_docs import citations, code_line, sections, with_code_lines
from rig.output.report.style import style

NOWHERE = "9.9"  # apart from the words before it, else this file would cite it

THEORY = """# Theory

## 1 The motor

### 1.1 The plant

    v = K u

### 1.2 Limits

Words alone.
"""


def test_citations_are_found_in_sentences_lists_and_across_lines() -> None:
    assert citations("(docs/theory.md 4.2).") == {"4.2"}
    assert citations("docs/theory.md 3.1, 4.3 and 6.2, and more") == {"3.1", "4.3", "6.2"}
    assert citations("# see docs/theory.md\n# 7.10") == {"7.10"}
    assert citations("docs/theory.md alone") == set()


def test_what_a_page_names_must_be_where_it_says() -> None:
    place = "tools/check_docs.py"
    there = f"`check_docs.py`, `test_tools_docs.py::{test_sections_are_what_their_headings_number.__name__}`"
    assert list(check_docs.lost_places(f"{there}, `problems` in `{place}`")) == []
    gone = ("no_" + "such", "sections" + "_of")  # apart, else this file would name them
    lost = f"`{gone[0]}.py`, `test_tools_docs.py::{gone[1]}`, `{gone[1]}` in `{place}`"
    assert [line.split(",")[0] for line in check_docs.lost_places(lost)] == [
        f"names {gone[0]}.py",
        f"names test_tools_docs.py::{gone[1]}",
        f"names {gone[1]} in {place}",
    ]


def test_the_end_of_a_path_is_that_of_one() -> None:
    assert list(check_docs.lost_places("`tools/test_tools_docs.py`, `tests/tools/test_tools_docs.py`")) == []
    gone = "no_such/check_docs" + ".py"  # apart, else this file would name it
    assert list(check_docs.lost_places(f"`{gone}`")) == [f"names {gone}, which is the end of no path"]


def test_a_question_of_the_map_has_one_file() -> None:
    assert list(check_docs.unanswered("| Which laws? | `tools/check_docs.py` |\n| May it | be anything |")) == []
    unsure = "| Which laws? | `tools/check_docs.py`, `tools/figures.py` |\n| Whose? | nobody's |\n"
    found = [line.split(" One ")[0] for line in check_docs.unanswered(unsure)]
    assert found == ["asks: Which laws?", "asks: Whose?"]


def test_sections_are_what_their_headings_number() -> None:
    assert list(sections(THEORY)) == ["1", "1.1", "1.2"]
    assert "v = K u" in sections(THEORY)["1.1"]


def test_the_lists_of_code_are_written_once_and_stay() -> None:
    cited = {"rig/model/motor.py": {"1.1"}, "tests/model/test_model_motor.py": {"1.1"}}
    once = with_code_lines(THEORY, cited)
    assert code_line("1.1", cited) == "Code: `rig/model/motor.py`\n"
    assert once.count("Code:") == 1
    assert with_code_lines(once, cited) == once


def test_a_citation_of_no_section_and_a_formula_that_nobody_cites_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "theory.md"
    page.write_text(THEORY, encoding="utf-8")
    source = tmp_path / "law.py"
    source.write_text(f'"""A law (docs/theory.md {NOWHERE})."""\n', encoding="utf-8")
    monkeypatch.setattr(check_docs, "THEORY", page)
    monkeypatch.setattr(check_docs, "ROOT", tmp_path)
    monkeypatch.setattr(check_docs, "listed", lambda *patterns: ["law.py"])
    assert list(check_docs.theory_problems()) == [
        f"law.py: cites docs/theory.md {NOWHERE}, which is not there",
        "docs/theory.md 1.1: has a formula, and no file of rig cites it",
    ]


def test_a_link_to_a_heading_that_is_not_there_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One, two\n\n[here](#one-two) [gone](#three)\n", encoding="utf-8")
    assert check_docs.problems(page) == ["link to #three of page.md, which has no such heading"]


def test_a_page_that_does_not_say_for_whom_it_is_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "Makefile").touch()
    (tmp_path / "docs/evidence").mkdir(parents=True)
    monkeypatch.setattr(check_docs, "ROOT", tmp_path)
    monkeypatch.setattr(check_docs, "EVIDENCE", tmp_path / "docs/evidence")
    for name in ("docs/page.md", "docs/evidence/table.md", "README.md"):
        (tmp_path / name).write_text("# Title\n\nIt works.\n", encoding="utf-8")
    (tmp_path / "docs/said.md").write_text("# Title\n\nFor everybody who asks.\n", encoding="utf-8")
    missing = "the line below its title does not say for whom it is: For everybody who ..."
    assert check_docs.problems(tmp_path / "docs/page.md") == [missing]
    for name in ("docs/said.md", "docs/evidence/table.md", "README.md"):
        assert check_docs.problems(tmp_path / name) == []


@pytest.mark.parametrize("draw", [figures.limit_cycle_figure, figures.describing_function_figure])
def test_the_figures_of_the_theory_can_be_drawn(draw: object) -> None:
    assert callable(draw)
    with style():
        assert draw().uri.startswith("data:image/svg+xml")
