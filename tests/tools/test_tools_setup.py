"""What a new clone asks for: `make demo` takes Python, a C compiler and a network, and names what is missing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
import yaml
from evidence import evidence
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
# rig's command line where some modules are not installed
WITHOUT = """
import sys

class Absent:
    names = set(sys.argv.pop(1).split(","))

    def find_spec(self, name, path=None, target=None):
        if name in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from rig.cli import main
main(sys.argv[1:])
"""
TYPED = ("cat", "dirname", "env", "grep", "id", "make", "sh", "tail", "touch")  # by the set-up, and no compiler


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What make looks at, without .venv."""
    folder = tmp_path / "clone"
    (folder / "tools").mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "tools/setup.sh"):
        shutil.copy(ROOT / name, folder / name)
    return folder


def make(clone: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A make that knows nothing of the one that runs the tests."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS", "CC"))}
    return subprocess.run(
        ["make", *words], cwd=clone, env=inherited | environment, capture_output=True, text=True, check=False
    )


def test_the_demo_sets_up_what_rig_runs_on_and_runs_and_nothing_else(clone: Path) -> None:
    done = make(clone, "-n", "demo")
    *ran, said = done.stdout.splitlines()
    assert ran == ["./tools/setup.sh running", ".venv/bin/rig run config/demo.yaml"], done.stderr
    assert said.startswith("echo ") and ". .venv/bin/activate" in said  # the demo's own lines say `rig`


@pytest.mark.parametrize(
    ("lacks", "named"),
    [
        ("cc", ("C compiler", "firmware", "gcc libc6-dev")),
        ("venv", ("no module venv", "environment", "python3-venv")),
        ("python", ("Python 3.11", "/nowhere/python3 is missing", "make PYTHON=")),
        *evidence(("network", ("packages could not be fetched", "network", "uv"))),
    ],
)
def test_what_is_missing_is_named_in_one_line_before_the_firmware_is_built(
    clone: Path, tmp_path: Path, lacks: str, named: tuple[str, ...]
) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in TYPED if lacks == "cc" else (*TYPED, "cc"):
        (tools / name).symlink_to(shutil.which(name) or f"no {name}")
    (tmp_path / "split").mkdir()  # as Debian has it
    (tmp_path / "split" / "ensurepip.py").write_text("raise ImportError\n", encoding="utf-8")
    python = "/nowhere/python3" if lacks == "python" else sys.executable
    done = make(
        clone, "demo", PATH=str(tools), PYTHON=python, PYTHONPATH=str(tmp_path / "split") if lacks == "venv" else "",
        PIP_NO_INDEX="1", PIP_CONFIG_FILE=os.devnull, PIP_FIND_LINKS="",
    )  # fmt: skip
    said, made = done.stderr.splitlines()
    assert done.returncode == 2
    assert said.startswith("setup: ") and all(word in said for word in named), said
    assert made.startswith("make: *** ")  # that it stops here
    assert (clone / ".venv").exists() == (lacks == "network")


def run_on() -> set[str]:
    """The packages that an installation without extras brings."""
    found, todo = set[str](), ["motor-rig"]
    while todo:
        name = canonicalize_name(todo.pop())
        if name not in found:
            found.add(name)
            wanted = map(Requirement, requires(name) or [])
            todo += [one.name for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    return found


@pytest.mark.evidence
def test_a_run_and_its_report_need_no_package_but_those_that_rig_runs_on(tmp_path: Path) -> None:
    """The packages for tests, checks and documents would hide one that a demo lacks."""
    runs_on = run_on()
    absent = {
        name
        for name, brought_by in packages_distributions().items()
        if not runs_on & {canonicalize_name(one) for one in brought_by}
    }
    assert {"pytest", "pandas", "setuptools", "starlette"} <= absent and "numpy" not in absent
    short = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    short["relay"] = {"gains": [{"h1_V": 0.45, "h2_V": 0.9}], "cycles": 4}
    short["tracking"] |= {"duration_s": 2.0, "methods": ["sampled-data"]}
    config = tmp_path / "short.yaml"
    config.write_text(yaml.safe_dump(short), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, ",".join(absent), "run", config, "--out", tmp_path],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("*/report.html"))) == 1
