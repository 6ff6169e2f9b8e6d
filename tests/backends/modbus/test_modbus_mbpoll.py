"""A master that is not ours reads and drives our emulated I/O block: Debian's mbpoll against `rig emulate`."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rig.config import dump, load
from rig.config.schema import Experiment

CONFIG = Path(__file__).resolve().parents[3] / "config"
WATCHDOG_MS = 800


class Mbpoll:
    """One call, one exchange; references are counted from 0, as in the config."""

    def __init__(self, port: str, suggested: str = "") -> None:
        self.suggested = shlex.split(suggested)  # what `rig emulate` says that one may try
        if port.startswith("tcp://"):
            self._host, number = port.removeprefix("tcp://").split(":")
            self._options = ["-m", "tcp", "-p", number]
        else:
            self._host = port
            self._options = ["-m", "rtu", "-b", "115200", "-P", "none"]

    def call(self, *options: str, values: tuple[int, ...] = ()) -> subprocess.CompletedProcess[str]:
        command = ["mbpoll", *self._options, "-a", "1", "-0", "-1", "-o", "2", *options, self._host]
        if values:
            command += [str(value & 0xFFFF) for value in values]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    def read(self, first: int, count: int, table: str = "4") -> list[int]:
        """16-bit registers as unsigned numbers; table 3: input, 4: holding."""
        done = self.call("-t", table, "-r", str(first), "-c", str(count))
        assert done.returncode == 0, done.stderr
        found = {int(a): int(v) for a, v in re.findall(r"^\[(\d+)\]:\s+(-?\d+)", done.stdout, re.MULTILINE)}
        return [found[first + k] for k in range(count)]

    def write(self, first: int, *values: int) -> None:
        """FC06 of one value, FC16 of several."""
        done = self.call("-t", "4", "-r", str(first), values=values)
        assert done.returncode == 0, done.stderr
        assert f"Written {len(values)} references" in done.stdout


@contextmanager
def emulated(tmp_path: Path, kind: str, **registers: Any) -> Iterator[Mbpoll]:
    """`rig emulate` as a user starts it, with these registers of the example's changed."""
    data = load(CONFIG / f"modbus-{kind}.yaml").model_dump(mode="json", exclude_none=True)
    data["daq"]["modbus"]["registers"] |= registers
    if registers:
        data["daq"]["modbus"]["requests"] = "separate"
        data["period_s"] = 0.02  # two requests a tick
    config = tmp_path / "modbus.yaml"
    config.write_text(dump(Experiment.model_validate(data)), encoding="utf-8")
    command = [sys.executable, "-m", "rig", "emulate", str(config)]
    if kind == "rtu":
        command += ["--link", str(tmp_path / "port")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    try:
        said = process.stdout.readline()
        named = re.search(r"emulated device on (\S+?);", said)
        assert named is not None, said or process.stderr.read()
        yield Mbpoll(named.group(1), process.stdout.readline().removeprefix("try:"))
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate()


def armed(master: Mbpoll) -> None:
    """Settings by FC16 (watchdog in ms, limits, largest drive, rails), then the control register by FC06."""
    master.write(9, WATCHDOG_MS, 40, 985, 2500, 5, 1018)
    assert master.read(9, 6) == [WATCHDOG_MS, 40, 985, 2500, 5, 1018]
    master.write(8, 1)


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["rtu", "tcp"])
def test_mbpoll_drives_the_motor_until_its_own_silence_stops_it(kind: str, tmp_path: Path) -> None:
    with emulated(tmp_path, kind) as master:
        start, _, applied, status = master.read(16, 4)
        assert (applied, status) == (0, 0)
        assert 500 < start < 530  # the centre, with noise and offset of the example
        armed(master)
        assert master.read(18, 2) == [0, 1]
        master.write(0, 550)  # 0.66 V: past breakaway, about 1 rad/s
        assert master.read(18, 2) == [550, 1]
        while master.read(19, 1) == [1]:  # reading alone does not keep the drive up
            time.sleep(0.05)
        position, _, applied, status = master.read(16, 4)
        assert (applied, status) == (0, 2)
        assert position > start + 50
        # the other way, after arming anew
        master.write(8, 1)
        master.write(0, -550)
        assert master.read(18, 2) == [0x10000 - 550, 1]
        while master.read(19, 1) == [1]:
            time.sleep(0.05)
        assert master.read(16, 1)[0] < position - 50


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["rtu", "tcp"])
def test_mbpoll_is_told_what_it_may_not(kind: str, tmp_path: Path) -> None:
    with emulated(tmp_path, kind) as master:
        tried = subprocess.run(master.suggested, capture_output=True, text=True, check=False)
        assert tried.returncode == 0, tried
        assert "[16]:" in tried.stdout
        if kind == "rtu":
            foreign = master.call("-a", "9", "-o", "0.1", "-r", "16")
            assert "timed out" in foreign.stderr + foreign.stdout
        for options, values, says in (
            (("-t", "4", "-r", "300"), (), "Illegal data address"),
            (("-t", "4", "-r", "300"), (1,), "Illegal data address"),
            (("-t", "3", "-r", "16"), (), "Illegal data address"),  # all is in the holding registers
            (("-t", "0", "-r", "0"), (), "Illegal function"),  # no coils
            (("-t", "4", "-r", "8"), (7,), "Illegal data value"),  # control: 1 arms, 0 stops
            (("-t", "4", "-r", "8"), (1,), "Slave device or server failure"),  # it was never told its limits
        ):
            refused = master.call(*options, values=values)
            assert refused.returncode != 0
            assert says in refused.stderr + refused.stdout, refused
        master.write(0, 550)
        assert master.read(18, 2) == [0, 6]  # not armed
        armed(master)
        master.write(0, 2501)
        assert master.read(18, 2) == [0, 5]  # beyond the largest drive
        master.write(8, 0)
        assert master.read(18, 2) == [0, 0]


@pytest.mark.realtime
def test_mbpoll_reads_what_is_in_the_input_registers(tmp_path: Path) -> None:
    with emulated(tmp_path, "rtu", position={"address": 16, "table": "input"}) as master:
        armed(master)
        master.write(0, 300, 77)  # drive, sequence number
        position, echo, applied, status = master.read(16, 4, table="3")
        assert 500 < position < 530
        assert (echo, applied, status) == (77, 300, 1)
