"""Holds the documents against the project: links, paths, commands, make targets, and the theory that the code cites.

python tools/check_docs.py          exit status 1 with one line for each thing that does not hold
python tools/check_docs.py --fix    first writes the lines `Code:` of docs/theory.md anew, from what the code cites
"""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import click

from rig.cli import main as rig_command

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]+))?\)")
CODE = re.compile(r"```\w*\n(.*?)```|`([^`\n]+)`", re.DOTALL)

# a path of the project in a line of code, such as `rig/control/guard.py`
PATH = re.compile(r"`((?:rig|tests|tools|firmware|config|docs)/[\w./-]*)`")
# the end of such a path: `departures/laws.py`
END = re.compile(r"`((?:[\w-]+/)+[\w-]+\.(?:py|c|h))`")
# a Python file by its name alone, perhaps with a test in it: `test_cli_run.py::test_a_run`
FILE = re.compile(r"`([\w-]+\.py)(?:::(\w+))?`")
# something in a file: `Loop.armed` in `rig/control/loop/runner.py`
PLACE = re.compile(r"`(?:\w+\.)*(\w+)` in `((?:rig|tests|tools|firmware)/[\w./-]+\.\w+)`")
# these tell of the project as it was when they were written
HISTORY = ("docs/evidence/mutant-table.md", "CHANGELOG.md")

# pages that a command writes say what made them instead
EVIDENCE = ROOT / "docs" / "evidence"
READER = re.compile(r"# .*\n\nFor \S")
QUESTION = re.compile(r"^\| (.*\?) \| (.*) \|$", re.MULTILINE)

MAP = "architecture.md"
THEORY = ROOT / "docs" / "theory.md"
# "docs/theory.md 4.2", "docs/theory.md 3.1, 4.3 and 6.2", "docs/theory.md, section 7.1"
CITED = re.compile(r"docs/theory\.md(?:, sections?)? (\d+(?:\.\d+)?(?:(?:, | and )\d+(?:\.\d+)?)*)")
CITED_ELSEWHERE = re.compile(r"\btheory,? (?:sections? )?\d", re.IGNORECASE)
HEADING = re.compile(r"^##+ (\d+(?:\.\d+)?) .*$", re.MULTILINE)
FORMULA = re.compile(r"^    \S", re.MULTILINE)
CODE_LINE = re.compile(r"^Code: [^\n]*\n(?:`[^\n]*\n)*", re.MULTILINE)
WIDTH = 140


def commands(text: str) -> list[list[str]]:
    """Words of every line of code that starts with `rig` or `make`."""
    lines = [line for block, inline in CODE.findall(text) for line in (block or inline).splitlines()]
    words = [line.split("#")[0].replace("$ ", "").split() for line in lines]
    return [w for w in words if len(w) > 1 and w[0] in ("rig", "make")]


def options(command: click.Command) -> set[str]:
    """Every spelling of every option of a command."""
    return {name for parameter in command.params for name in parameter.opts} | {"--help", "-h"}


def anchors(path: Path) -> set[str]:
    """The anchors that a Markdown viewer makes of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(path: Path, text: str) -> Iterator[str]:
    """Links of one document to a file, or to a heading, that is not there."""
    for target, anchor in LINK.findall(text):
        if "://" in target:
            continue
        file = path.parent / target if target else path
        if not file.exists():
            yield f"link to {target}, which is not there"
        elif anchor and file.suffix == ".md" and anchor not in anchors(file):
            yield f"link to #{anchor} of {file.name}, which has no such heading"


def lost_places(text: str) -> Iterator[str]:
    """Python files that a document names and that are nowhere, and things that are not in the file it names."""
    for name, inside in FILE.findall(text):
        files = [ROOT / file for file in listed(f"*{name}") if Path(file).name == name]
        if not files and listed(f"rig/output/export/templates/{name}.j2"):
            continue  # rig writes it
        if not files:
            yield f"names {name}, which is nowhere"
        elif inside and not any(inside in file.read_text(encoding="utf-8") for file in files):
            yield f"names {name}::{inside}, which is not there"
    for name in END.findall(text):
        if not listed(name, f"*/{name}"):
            yield f"names {name}, which is the end of no path"
    for inside, name in PLACE.findall(text):
        if (ROOT / name).is_file() and inside not in (ROOT / name).read_text(encoding="utf-8"):
            yield f"names {inside} in {name}, which is not there"


def unanswered(text: str) -> Iterator[str]:
    """Questions of the map of the code that not one file alone answers."""
    for question, answer in QUESTION.findall(text):
        if len(PATH.findall(answer)) != 1:
            yield f"asks: {question} One file must answer, not {answer}"


def problems(path: Path) -> list[str]:
    """What does not hold in one document."""
    text = path.read_text(encoding="utf-8")
    found = list(broken_links(path, text)) + (list(unanswered(text)) if path.name == MAP else [])
    is_page = path.is_relative_to(ROOT / "docs") and (path.parent != EVIDENCE or path.name == "README.md")
    if is_page and not READER.match(text):
        found.append("the line below its title does not say for whom it is: For everybody who ...")
    if not path.as_posix().startswith(tuple((ROOT / name).as_posix() for name in HISTORY)):
        found += [f"names {name}, which is not there" for name in PATH.findall(text) if not (ROOT / name).exists()]
        found += lost_places(text)
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for words in commands(text):
        if words[0] == "make":
            if words[1].isalpha() and words[1] not in targets:
                found.append(f"`make {words[1]}`: no such target")
            continue
        command = rig_command.commands.get(words[1])
        if command is None:
            if words[1].isalpha():
                found.append(f"`rig {words[1]}`: no such command")
            continue
        found += [
            f"`rig {words[1]} {word}`: no such option"
            for word in words[2:]
            if re.fullmatch(r"--[A-Za-z0-9-]+", word) and word not in options(command)
        ]
    return found


def citations(text: str) -> set[str]:
    """Sections of the theory that a source file cites, such as "4.2"."""
    one_line = re.sub(r"\s+(?:# )?", " ", text)
    return {section for cited in CITED.findall(one_line) for section in re.split(r", | and ", cited)}


def sections(theory: str) -> dict[str, str]:
    """Number and text of each section, without those below it."""
    found = list(HEADING.finditer(theory))
    ends = [*(heading.start() for heading in found[1:]), len(theory)]
    return {heading[1]: theory[heading.start() : end] for heading, end in zip(found, ends, strict=True)}


def cited_by_file() -> dict[str, set[str]]:
    """The sections that each Python file and config cites, by its path."""
    files = listed("*.py", "config/*.yaml")
    return {name: citations((ROOT / name).read_text(encoding="utf-8")) for name in files}


def code_line(number: str, cited: dict[str, set[str]]) -> str:
    """The line that names the files of rig and tools which cite a section; empty if there are none."""
    files = sorted(
        name for name, numbers in cited.items() if number in numbers and name.startswith(("rig/", "tools/paper/"))
    )
    words = ", ".join(f"`{name}`" for name in files)
    return "\n".join(textwrap.wrap(f"Code: {words}", WIDTH, break_on_hyphens=False)) + "\n" if files else ""


def with_code_lines(theory: str, cited: dict[str, set[str]]) -> str:
    """The theory, each section ending with the files that cite it."""
    for number, text in sections(theory).items():
        body, line = CODE_LINE.sub("", text).rstrip("\n"), code_line(number, cited)
        after = text[len(text.rstrip("\n")) :]
        theory = theory.replace(text, f"{body}\n\n{line}".rstrip("\n") + after)
    return theory


def theory_problems() -> Iterator[str]:
    """Citations of sections that are not there, and formulas of which nobody says where they are used."""
    theory, cited = THEORY.read_text(encoding="utf-8"), cited_by_file()
    numbers = sections(theory)
    for name, own in cited.items():
        yield from (f"{name}: cites docs/theory.md {number}, which is not there" for number in own - numbers.keys())
        if CITED_ELSEWHERE.search((ROOT / name).read_text(encoding="utf-8")) and name != "tools/check_docs.py":
            yield f"{name}: cites a theory by number alone: write docs/theory.md and the section, such as 4.2"
    for number, text in numbers.items():
        line = code_line(number, cited)
        if FORMULA.search(text) and not line:
            yield f"docs/theory.md {number}: has a formula, and no file of rig cites it"
        if "".join(CODE_LINE.findall(text)) != line:
            yield f"docs/theory.md {number}: its line `Code:` is not what cites it: python tools/check_docs.py --fix"


def listed(*patterns: str) -> list[str]:
    """Paths of all files that git tracks, or would, which fit one of the patterns and are there."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", *patterns]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return sorted({name for name in names if (ROOT / name).exists()})


def main() -> int:
    """Check every tracked Markdown file, and the theory against the code."""
    if "--fix" in sys.argv[1:]:
        text = THEORY.read_text(encoding="utf-8")
        THEORY.write_text(with_code_lines(text, cited_by_file()), encoding="utf-8")
    bad = [f"{name}: {problem}" for name in listed("*.md") for problem in problems(ROOT / name)]
    bad += theory_problems()
    print("\n".join(bad) or "docs: links, commands, targets and theory hold")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
