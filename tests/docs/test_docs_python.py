"""Each block of Python on the pages is run, page by page and in order, in a folder with the files that it reads.

So is that of MATLAB, in Octave. What a block of C says is in tests/export.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import rig as command
from compared_runs import Told, result_of, write_run, write_samples

import rig
from check_docs import listed

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden" / "simulated"
# pages whose blocks another test runs: it reads the page, or they stand in it
ELSEWHERE = {
    "docs/exercises.md": "tests/docs/test_docs_exercises.py",
    "docs/plug-in-driver.md": "tests/testing/test_conformance_built_in.py",
}


def blocks(language: str) -> dict[str, list[str]]:
    """By page, the blocks of code in that language."""
    fence = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    found = {page: fence.findall((ROOT / page).read_text(encoding="utf-8")) for page in listed("*.md")}
    return {page: its for page, its in found.items() if its}


PYTHON = blocks("python")


def run(page: str, block: str, names: dict[str, Any]) -> Any:
    """Run a block with the names that those before it have left; what its last line is worth, if anything."""
    lines = ast.parse(block, page).body
    last = lines.pop() if isinstance(lines[-1], ast.Expr) else None
    exec(compile(ast.Module(lines, []), page, "exec"), names)
    return eval(compile(ast.Expression(last.value), page, "eval"), names) if isinstance(last, ast.Expr) else None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the blocks read, by the names that the pages give them."""
    here = tmp_path_factory.mktemp("python")
    (here / "simulated.yaml").write_bytes(rig.ready("simulated").read_bytes())
    recorded = here / "runs" / "20261122T103000Z-run-simulated"
    recorded.mkdir(parents=True)
    for name in ("config.yaml", "events.jsonl", "meta.json", "samples.csv"):
        (recorded / name).write_bytes((GOLDEN / name).read_bytes())
    (recorded / "result.json").write_text(json.dumps(result_of(Told())), encoding="utf-8")
    for at, name in enumerate("abc"):
        write_samples(write_run(here / "runs" / name, Told(fc_V=0.48 + 0.02 * at), hour=at), at)
    for options in (["any.csv", "--stage", "relay-1"], ["run.npz"], ["run.mat"]):
        assert command("export", recorded, "--to", here / options[0], *options[1:]).exit_code == 0
    assert command("export", recorded, "--to", "control", "--into", here).exit_code == 0
    return here


@pytest.fixture
def working(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """It is the working folder, and Python imports from it."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    yield folder
    sys.modules.pop("motor_control", None)


@pytest.mark.parametrize("page", sorted(PYTHON.keys() - ELSEWHERE.keys()))
def test_the_python_of_a_page_runs(page: str, working: Path) -> None:
    names: dict[str, Any] = {}
    last = [run(page, block, names) for block in PYTHON[page]]
    # what a page is about, where it says so at its end
    match page:
        case "docs/api.md":
            assert names["found"].best.verdict in ("ok", "doubtful") and last[1] is True
        case "docs/compare.md":
            assert names["found"].differs_measurably and (working / "compare.html").exists()
        case "docs/export.md":
            assert last[0]["sampled-data"]["tau_s"] == 0.17 and names["found"].success


def test_no_block_of_python_is_forgotten() -> None:
    assert {"README.md", "docs/api.md", "docs/compare.md", "docs/export.md"} <= PYTHON.keys() - ELSEWHERE.keys()
    for page, test in ELSEWHERE.items():
        text = (ROOT / test).read_text(encoding="utf-8")
        for block in PYTHON[page]:
            assert page in text or repr(block)[1:-1] in text, page
    fences = re.findall(r"^```(\w+)", "\n".join((ROOT / page).read_text("utf-8") for page in listed("*.md")), re.M)
    assert set(fences) <= {"sh", "python", "matlab", "c", "yaml", "toml"}  # no other name for Python, which nobody runs


def test_the_matlab_of_the_pages_runs_in_octave(folder: Path) -> None:
    (block,) = (block for its in blocks("matlab").values() for block in its)
    script = f"plot = @(x, y) assert (numel(x) == numel(y) && numel(x) > 1000);\n{block}"  # there may be no display
    command = ["octave-cli", "--quiet", "--no-init-file", "--no-history", "--eval", script]
    said = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    assert "ans = 0.17" in said.stdout and said.stderr == ""
