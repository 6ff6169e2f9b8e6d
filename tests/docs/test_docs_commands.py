"""Each command in the pages' blocks of shell code is run: here, or by the test that `run_elsewhere.yaml` names.

Of the latter the words are held: each stands in that test, or beside it in the list, and rig takes them.
"""

from __future__ import annotations

import ast
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from check_docs import listed
from rig.cli import main
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"\s+# .*$")
ASSIGNED = re.compile(r"(?P<name>[A-Z]+)=")
# what is piped into rig is typed by bash
RIG = re.compile(r"(?:(?P<before>.*) \| )?(?P<command>rig .*)")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
HELPERS = ("awk ", "cp ", "head ", "python3 -c ")  # other lines that make or show what a command reads
SIMULATED, RUN = "rig run config/simulated.yaml", "20261123T120000Z-run-simulated"


class Line(NamedTuple):
    """A line of code without its comment, and the page that it stands on."""

    page: str
    text: str

    @property
    def is_command(self) -> bool:
        """Whether somebody has to run it: a command of rig, make or any other program that is no helper."""
        is_other = not self.text or self.text.startswith(("#", *HELPERS)) or ASSIGNED.match(self.text) is not None
        return RIG.fullmatch(self.text) is not None or not is_other


def lines() -> Iterator[Line]:
    """All lines of the pages' blocks of shell code, in their order."""
    for page in listed("*.md"):
        for block in BLOCK.findall((ROOT / page).read_text(encoding="utf-8")):
            for text in block.splitlines():
                yield Line(page, COMMENT.sub("", text).strip())


class Elsewhere(NamedTuple):
    """Commands that are not run here; ``instead`` and ``parsed`` as the list says."""

    why: str
    commands: list[str]
    test: str = ""
    instead: Mapping[str, str] = {}
    parsed: Sequence[str] = ()

    def unheld(self) -> list[str]:
        """Words of its commands that stand neither in the test nor in the list, and entries that nothing needs."""
        source, failed, needless = source_of(self.test), [], {*self.instead, *self.parsed}
        typed = typed_in(source)
        for command in self.commands:
            for word in shlex.split(command)[1:]:
                if word in self.parsed or word in self.instead:
                    needless.discard(word)
                elif not word.startswith("$") and not typed & {word, Path(word).name}:
                    failed.append(f"{self.test} has no {word!r} of: {command}")
        failed += [f"{self.test} has no {there!r}" for there in self.instead.values() if not stands(there, source)]
        return failed + [f"{self.test}: {word!r} is in no command" for word in needless]


def typed_in(source: str) -> set[str]:
    """The texts of a source, whole and word by word; not its names, comments and docstrings, which run nothing."""
    tree = ast.parse(source)
    told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told
    ]
    return {word for text in texts for word in (text, *text.split())}


def stands(there: str, source: str) -> bool:
    """Whether a piece of code stands in a source, and not as a part of a longer word."""
    return re.search(rf"(?<![\w-]){re.escape(there)}(?![\w-])", source) is not None


def source_of(test: str) -> str:
    """The source of a test, and of all in its file that it names: fixtures, helpers, constants."""
    file, _, name = test.partition("::")
    text = (ROOT / file).read_text(encoding="utf-8")
    defined: dict[str, ast.stmt] = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined[node.name] = node
        elif isinstance(node, ast.Assign):
            names = (one for target in node.targets for one in ast.walk(target))
            defined |= {one.id: node for one in names if isinstance(one, ast.Name)}
    found: dict[str, str] = {}
    todo = [name]
    while todo:
        one = todo.pop()
        if one not in defined or one in found:
            continue
        found[one] = "\n".join(
            ast.get_source_segment(text, part) or ""
            for part in (*getattr(defined[one], "decorator_list", ()), defined[one])
        )
        for part in ast.walk(defined[one]):
            todo += [value for value in vars(part).values() if isinstance(value, str)]
    return "\n".join(found.values())


ELSEWHERE = [
    Elsewhere(**entry)
    for entry in yaml.safe_load(Path(__file__).with_name("run_elsewhere.yaml").read_text(encoding="utf-8"))
]


@dataclass
class Terminal:
    """A shell in a folder as the pages expect it; ``rig`` runs in this process."""

    folder: Path
    variables: dict[str, str]

    def type(self, text: str) -> str:
        """Run a line: a command of rig, an assignment or a helper. What a command that fails says, else nothing."""
        line = text.replace("/tmp/", f"{self.folder}/tmp/")
        assigned, command = ASSIGNED.match(line), RIG.fullmatch(line)
        if assigned is not None:
            self.variables[assigned["name"]] = self._bash(f'{line}\nprintf %s "${assigned["name"]}"')
        elif command is not None:
            # bash takes the words apart, with its variables, quotes and patterns
            words = self._bash(f"printf '%s\\0' {command['command']}").split("\0")[1:-1]
            typed = self._bash(command["before"]) if command["before"] else None
            done = CliRunner().invoke(main, words, input=typed)
            if done.exit_code != 0:
                return f"{text}: status {done.exit_code}: {done.output.strip()[-400:]} {done.exception!r}"
        elif line.startswith(HELPERS):
            self._bash(line)
        elif line and not line.startswith("#"):
            return f"{text}: nobody runs it, and run_elsewhere.yaml does not say why"
        return ""

    def _bash(self, script: str) -> str:
        environment = os.environ | self.variables | {"HOME": str(self.folder)}
        done = subprocess.run(["bash", "-ec", script], capture_output=True, text=True, check=True, env=environment)
        return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A clone's folder as somebody has it who has followed the pages so far, and the working folder of this process."""
    here = tmp_path_factory.mktemp("clone")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        (here / "config").symlink_to(ROOT / "config")
        for name in ("tmp", "firmware"):
            (here / name).mkdir()
        assert Terminal(here, {}).type(SIMULATED) == ""
        (run,) = (here / "runs").iterdir()
        for name in (RUN, "20261123T120100Z-law-simulated"):
            shutil.copytree(run, here / "runs" / name)
        tests = ROOT / "tests" / "golden" / "simulated"
        (here / "log.csv").write_text(log_of(read_run(tests)), encoding="utf-8")
        yield here


def log_of(run: Recording) -> str:
    """The first test of a run as a sketch logs it: with an encoder of 1440 counts, and 12 V at a PWM of 255."""
    rows = run.stage == "relay-1"
    columns = (1e3 * run.t_s, 255 / 12 * run.u_V, 1440 / math.tau * run.y_rad)
    numbers = np.rint(np.column_stack([column[rows] for column in columns])).astype(int)
    return "\n".join(["millis,pwm,counts", *(",".join(map(str, row)) for row in numbers.tolist())])


def test_every_command_of_the_pages_runs(folder: Path) -> None:
    done = {command for entry in ELSEWHERE for command in entry.commands} | {SIMULATED}
    failed = []
    for page, on_it in groupby(lines(), key=lambda line: line.page):
        terminal = Terminal(folder, {"RUN": f"{folder}/runs/{RUN}"})
        again = []
        for line in on_it:
            if line.text not in done and terminal.type(line.text):
                again.append(line.text)
            if line.is_command:
                done.add(line.text)
        # a page may read a file first, and say below how to make it
        failed += [f"{page}: {words}" for words in map(terminal.type, again) if words]
    assert failed == []


def test_the_readme_shows_the_answer_that_its_commands_give(folder: Path, tmp_path: Path) -> None:
    """Word for word, and in numbers, its intervals included; in a process of its own, which looks for laws."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    [shown] = re.findall(r"^rig identify any\.csv smaller\.csv .*\n```\n\n```\n((?:.*\n)*?)```", readme, re.MULTILINE)
    terminal = Terminal(tmp_path, {"RUN": f"{folder}/runs/{RUN}", "HERE": str(tmp_path)})
    for stage, name in (("relay-1", "any.csv"), ("relay-2", "smaller.csv")):
        typed = f"rig export $RUN --stage {stage} --to {name}"
        assert typed in readme
        assert terminal.type(typed.replace(name, f"$HERE/{name}")) == ""
    said = subprocess.run(
        [sys.executable, "-m", "rig", "identify", "any.csv", "smaller.csv"], cwd=tmp_path, check=True,
        capture_output=True, text=True,
    ).stdout  # fmt: skip
    assert NUMBER.sub("#", said) == NUMBER.sub("#", shown)
    assert [*map(float, NUMBER.findall(said))] == pytest.approx([*map(float, NUMBER.findall(shown))], rel=0.03)


def test_a_word_is_held_by_itself_and_not_as_a_part_of_another() -> None:
    source = 'def test_it() -> None:\n    """Not this run."""\n    assert rig("survey", "--to d.png", run_on) == prune'
    assert typed_in(source) == {"survey", "--to d.png", "--to", "d.png"}
    assert stands("run_on", source) and not stands("run", "survey(run_on, prune)")


def test_what_is_run_elsewhere_stands_on_a_page_and_in_the_test_that_runs_it() -> None:
    typed = {line.text for line in lines() if line.is_command}
    assert len(typed) > 70
    assert [command for entry in ELSEWHERE for command in entry.commands if command not in typed] == []
    held = [entry for entry in ELSEWHERE if entry.test]
    for entry in held:
        file, _, name = entry.test.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8"), entry.test
    assert [words for entry in held for words in entry.unheld()] == []


@pytest.mark.parametrize(
    "command", [command for entry in ELSEWHERE for command in entry.commands if RIG.fullmatch(command)]
)
def test_rig_takes_the_words_of_what_is_run_elsewhere(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its options, and their values: the command line is read, and nothing is done."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").symlink_to(ROOT / "config")
    _, name, *words = shlex.split(command.replace("$RUN", "."))
    for word in words:
        is_file = word.endswith((".yaml", ".csv", ".pem", ".key", ".password")) or word == "CONFIG"
        if is_file and "/" not in word:
            (tmp_path / word).touch()
    whole = main.make_context("rig", [name, *words])
    sub = main.get_command(whole, name)
    assert sub is not None
    sub.make_context(name, words, parent=whole)
