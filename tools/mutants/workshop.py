"""A copy of the tree, in which one defect at a time is put in and met by tests, within bounds of time and memory."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from mutants.functions import name_at
from mutants.mutant import Mutant

_LEFT_OUT = (
    ".git", ".venv", "build", "runs", "dist", "node_modules", "__pycache__", ".pytest_cache", ".mypy_cache",
    ".ruff_cache", ".hypothesis", ".import_linter_cache",
)  # fmt: skip
_NODE_MODULES = (Path("tests/hil/avr8js/node_modules"), Path("firmware/emulator/pico/node_modules"))
_NO_CLOCK = ("-m", "not (realtime or alone or evidence)")
_NAMED = ("-m", "not (alone or evidence)")
_FILE_BYTES = 2 << 30
_NICE = 10
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+\.py(?:::[^\[\s]+(?:\[.*?\])?)?)(?: - (.*))?$", re.MULTILINE)
_PASSED = re.compile(r"^PASSED (\S+\.py::[^\[\s]+(?:\[.*\])?)$", re.MULTILINE)
_TOOK = re.compile(r"^([\d.]+)s (?:call|setup|teardown) +(\S+\.py::.*)$", re.MULTILINE)
_C_FAILED = re.compile(r"^(?:\S*/)?(test_\w+\.c):(\d+): failed", re.MULTILINE)


@dataclass(frozen=True)
class Limits:
    """What tests may take: processor time of each process and time in all, s; address space of each process."""

    cpu_s: float
    wall_s: float
    memory_bytes: int = 8 << 30


@dataclass(frozen=True)
class Met:
    """How tests ended.

    outcome  "passed", "failed", or "hung" where the limits ended them
    by       tests that failed, or what there is to say
    cpu_s, wall_s   what they took
    output   what they wrote
    """

    outcome: str
    by: tuple[str, ...]
    cpu_s: float
    wall_s: float
    output: str


class Workshop:
    """A copy of a tree in a folder of its own; what is done to it does not reach the original."""

    def __init__(self, source: Path, folder: Path) -> None:
        self.source = source.absolute()
        self.tree = folder.absolute() / "tree"
        self._temporary = folder.absolute() / "tmp"
        self._environment = {
            key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")
        } | {
            "PYTHONPATH": f"{self.tree}{os.pathsep}{self.tree / 'tools'}",  # before the installed one
            "PYTHONDONTWRITEBYTECODE": "",  # a byte-code file goes by time and size: see ``with_defect``
            "OPENBLAS_NUM_THREADS": "1",
            "TMPDIR": str(self._temporary),
        }

    def prepare(self, only: str = "") -> None:
        """Make the copy that of the original as it is now; what was built in it stays where its sources are the same.

        only  this folder of it
        """
        known = {path.relative_to(self.tree) for path in self._files(self.tree)} if self.tree.is_dir() else set()
        wanted = {path.relative_to(self.source) for path in self._files(self.source / only)}
        for name in sorted(known - wanted) if not only else ():
            (self.tree / name).unlink()
        for name in wanted:
            content, copy = (self.source / name).read_bytes(), self.tree / name
            if name not in known or copy.read_bytes() != content:
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(content)
            shutil.copymode(self.source / name, copy)
        for modules in _NODE_MODULES:
            link = self.tree / modules
            if (self.source / modules).is_dir() and link.parent.is_dir() and not link.exists():
                link.symlink_to(self.source / modules)

    @staticmethod
    def _files(root: Path) -> Iterator[Path]:
        for folder, names, files in os.walk(root):
            names[:] = sorted(name for name in names if name not in _LEFT_OUT)
            yield from (Path(folder) / name for name in files if not (Path(folder) / name).is_symlink())

    @contextmanager
    def with_defect(self, mutant: Mutant) -> Iterator[None]:
        """In the block the copy has the defect. Raises AnchorError."""
        path = self.tree / mutant.path
        before = path.read_text(encoding="utf-8")
        changed = mutant.applied(before)
        try:
            self._write(path, changed)
            yield
        finally:
            self._write(path, before)

    @staticmethod
    def _write(path: Path, text: str) -> None:
        path.write_text(text, encoding="utf-8")
        # Python takes byte code for current by the second and the size, make by the time alone
        for cached in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            cached.unlink()

    def complaint(self, mutant: Mutant) -> str:
        """Why the firmware with that defect does not compile; empty where it does."""
        with self.with_defect(mutant):
            return "\n".join(
                made.stderr for command in compilers(mutant.path) if (made := self._run_plain(command)).returncode
            )

    def _run_plain(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command, cwd=self.tree / "firmware", capture_output=True, text=True, check=False)

    # ------------------------------------------------------------------ tests

    def meet(self, killers: Sequence[str], limits: Limits) -> Met:
        """Run tests until one fails: the firmware's own first, then pytest's."""
        programs = [killer for killer in killers if killer.endswith(".c")]
        nodes = [killer for killer in killers if not killer.endswith(".c")]
        spent = Met("passed", (), 0.0, 0.0, "")
        for program in programs:
            spent = _sum(spent, self._program(program, limits))
            if spent.outcome != "passed":
                return spent
        return _sum(spent, self._pytest(nodes, limits)) if nodes else spent

    def healthy(self, killers: Iterable[str], limits: Limits) -> dict[str, float]:
        """Those of the tests that pass without a defect, and the time that each takes, s."""
        passing: dict[str, float] = {}
        nodes = []
        for killer in killers:
            if not killer.endswith(".c"):
                nodes.append(killer)
            elif (met := self._program(killer, limits)).outcome == "passed":
                passing[killer] = met.wall_s
        command = [sys.executable, "-m", "pytest", "-rA", "--tb=no", "-p", "no:cacheprovider", *_marks(nodes)]
        output, tree = "", re.escape(str(self.tree))
        while nodes:
            output = self._limited([*command, "--durations=0", "--durations-min=0.01", *nodes], limits).output
            missing = [
                node
                for node in nodes
                if re.search(rf"(?:not found:|no collectors for) (?:{tree}/)?{re.escape(node)}$", output, re.MULTILINE)
            ]
            if not missing:
                break
            nodes = [node for node in nodes if node not in missing]  # else pytest runs none at all
        failed = {name for name, _ in _FAILED.findall(output)}
        took_s = dict.fromkeys(_PASSED.findall(output), 0.0)
        for seconds, name in _TOOK.findall(output):
            took_s[name] = took_s.get(name, 0.0) + float(seconds)
        for node in nodes:
            of_node = [name for name in took_s if _is_of(name, node)]
            if of_node and not any(_is_of(name, node) for name in failed):
                passing[node] = sum(took_s[name] for name in of_node)
        return passing

    def suite(self, limits: Limits) -> Met:
        """Every test that needs no real clock, until one fails."""
        return self._pytest((), limits)

    def _program(self, name: str, limits: Limits) -> Met:
        build = self.tree / "build" / "firmware"
        program = build / "host" / Path(name).stem
        make = ["make", "-s", "-C", "firmware", f"BUILD={build}", str(program)]
        # the address sanitizer asks for terabytes
        limits = replace(limits, memory_bytes=resource.RLIM_INFINITY)
        met = self._limited(["sh", "-c", '"$@" && exec "$0"', str(program), *make], limits)
        if met.outcome != "failed":
            return met
        text = (self.tree / name).read_text(encoding="utf-8")
        lines = [int(line) for file, line in _C_FAILED.findall(met.output) if file == Path(name).name]
        ends = [0]
        for line in text.splitlines(keepends=True):
            ends.append(ends[-1] + len(line))
        tests = dict.fromkeys(f"{name}::{name_at(text, ends[line - 1], is_c=True)}" for line in lines)
        # of a helper's check nobody knows whose it was
        by = sorted(tests, key=lambda test: "::test_" not in test) or [name]
        return Met("failed", tuple(by), met.cpu_s, met.wall_s, met.output)

    def _pytest(self, arguments: Sequence[str], limits: Limits) -> Met:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-rfE",
            "--tb=short",
            "-p",
            "no:cacheprovider",
            *_marks(arguments),
        ]
        # longer than any test takes on a busy machine: what hangs is ended by its processor time, or by this
        met = self._limited([*command, "--timeout", f"{limits.wall_s:.0f}", *arguments], limits)
        if met.outcome != "failed":
            return met
        by = tuple(name for name, _ in _FAILED.findall(met.output)) or met.by or ("cannot be collected",)
        hung = f"Timeout (>{limits.wall_s:.1f}s)" in met.output
        return Met("hung" if hung else "failed", by, met.cpu_s, met.wall_s, met.output)

    def _limited(self, command: Sequence[str], limits: Limits) -> Met:
        shutil.rmtree(self._temporary, ignore_errors=True)
        self._temporary.mkdir(parents=True)
        began_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        process = subprocess.Popen(
            command,
            cwd=self.tree,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            preexec_fn=lambda: _limit(limits),
        )
        try:
            output, _ = process.communicate(timeout=limits.wall_s)
            hung = -process.returncode in (signal.SIGXCPU, signal.SIGKILL)
        except subprocess.TimeoutExpired:
            hung = True
            output = ""
        finally:
            # what the tests started goes with them; what is in a session of its own ends when they are gone
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        if hung:
            process.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        wall_s = time.monotonic() - began_s
        if hung:
            return Met("hung", (f"ended after {cpu_s:.0f} s of processor time",), cpu_s, wall_s, output)
        code = process.returncode
        by = (f"ended by {signal.Signals(-code).name}",) if code < 0 else ()
        return Met("passed" if code == 0 else "failed", by, cpu_s, wall_s, output)


def compilers(path: str) -> list[list[str]]:
    """Commands, in the folder of the firmware, that compile what a file belongs to and keep nothing of it."""
    warnings = (
        "-std=c99 -fsyntax-only -Wall -Wextra -Werror -Wconversion -Wsign-conversion -Wshadow -Wstrict-prototypes"
    )
    options = [*warnings.split(), "-Icore", '-DRIG_BUILD="mutant"']
    inside = Path(path).relative_to("firmware")
    sources = [inside] if inside.suffix == ".c" else [Path("core/rig_core.c")]
    commands = []
    for source in map(str, sources):
        if not source.startswith(("boards/uno", "boards/pico", "boards/chip")):
            commands.append(["cc", *options, "-Iboards/host", "-Imotor", "-D_XOPEN_SOURCE=700", source])
        if source.startswith(("boards/uno", "boards/chip", "core")):
            uno = "-mmcu=atmega328p -Iboards/uno -DF_CPU=16000000UL -DRIG_BAUD=115200UL -DRIG_TACHOMETER=1"
            options = [*options, *uno.split(), "-Iboards/chip", "-DRIG_SUPPLY=1", "-DRIG_END_SWITCHES=1"]
            for bridge, encoder in (("BRIDGE_PWM_DIR", 0), ("BRIDGE_IN1_IN2", 1)):
                commands.append(["avr-gcc", *options, f"-DRIG_BRIDGE={bridge}", f"-DRIG_ENCODER={encoder}", source])
        if source.startswith("boards/pico"):
            pico = "-mcpu=cortex-m0plus -mthumb -ffreestanding -Iboards/pico -DRIG_BAUD=1000000u -DRIG_TACHOMETER=1"
            wired = "-Iboards/chip -DRIG_SUPPLY=1 -DRIG_END_SWITCHES=1 -DRIG_BRIDGE=BRIDGE_IN1_IN2 -DRIG_ENCODER=1"
            commands.append(["arm-none-eabi-gcc", *options, *pico.split(), *wired.split(), source])
    return commands


def _marks(nodes: Sequence[str]) -> tuple[str, ...]:
    """Which tests are left out: those that need a real clock, unless each is named, as those of a process's keeper."""
    return _NAMED if nodes and all("::" in node for node in nodes) else _NO_CLOCK


def _is_of(test: str, node: str) -> bool:
    """Whether a test is what a node names: itself, one of its examples, or one in that file or folder."""
    return test == node or test.startswith((f"{node}[", f"{node}::", f"{node}/"))


def _limit(limits: Limits) -> None:
    seconds = max(int(limits.cpu_s), 1)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
    os.setpriority(os.PRIO_PROCESS, 0, max(_NICE, os.getpriority(os.PRIO_PROCESS, 0)))
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")  # the first to go where memory is short


def _sum(one: Met, other: Met) -> Met:
    return Met(other.outcome, other.by, one.cpu_s + other.cpu_s, one.wall_s + other.wall_s, one.output + other.output)
