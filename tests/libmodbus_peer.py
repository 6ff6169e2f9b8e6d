"""A slave on libmodbus (tests/backends/modbus/libmodbus_slave), compiled where it is not up to date, as a process."""

from __future__ import annotations

import csv
import os
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

_ROOT = Path(__file__).resolve().parent.parent
_SOURCE = Path(__file__).resolve().parent / "backends" / "modbus" / "libmodbus_slave" / "slave.c"
_FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I/usr/include/modbus"]

EXAMPLE_MAP = (
    "drive=0:int16", "sequence=1", "control=8", "watchdog=9", "low=10", "high=11", "max_drive=12:int16",
    "rail_low=13", "rail_high=14", "position=16", "echo=17", "applied=18:int16", "status=19",
)  # fmt: skip


def build() -> Path:
    """The slave's program; processes may build at the same time."""
    program = _ROOT / "build" / "tests" / "libmodbus_slave"
    if not program.exists() or program.stat().st_mtime < _SOURCE.stat().st_mtime:
        program.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=program.parent) as folder:
            made = Path(folder) / "slave"
            subprocess.run(["cc", *_FLAGS, str(_SOURCE), "-o", str(made), "-lmodbus", "-lm"], check=True)
            made.replace(program)
    return program


class Executed(NamedTuple):
    """A drive that the slave executed: when (CLOCK_MONOTONIC), how much (its units), why."""

    t_s: float
    drive: float
    cause: str


class LibmodbusSlave:
    """The slave, running for the block. ``port``: pseudo-terminal of kind rtu, ``tcp://127.0.0.1:N`` of kind tcp."""

    def __init__(self, kind: str, *options: str, log: Path | None = None) -> None:
        self._log = log
        arguments = [str(build()), kind, *options] + ([f"log={log}"] if log is not None else [])
        self._process = subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ | {"LC_ALL": "C"}
        )
        assert self._process.stdout is not None
        words = self._process.stdout.readline().split()
        if len(words) != 2:
            raise RuntimeError(f"the slave did not start: exit status {self._process.wait()}")
        self.port = words[1] if kind == "rtu" else f"tcp://127.0.0.1:{words[1]}"

    def executed(self) -> list[Executed]:
        """What its motor got so far."""
        assert self._log is not None
        with self._log.open(newline="") as file:
            return [Executed(float(r["t_s"]), float(r["drive"]), r["cause"]) for r in csv.DictReader(file)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(5.0)
        self._process.stdout.close()
