"""A master that is not ours reads and drives our emulated I/O block: Debian's mbpoll against `rig emulate`."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

CONFIG = Path(__file__).resolve().parents[3] / "config"
WATCHDOG_MS = 800


class Mbpoll:
    """One call, one exchange; references are counted from 0, as in the config."""

    def __init__(self, port: str) -> None:
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

    def read(self, first: int, count: int) -> list[int]:
        """Holding registers as unsigned numbers."""
        done = self.call("-t", "4", "-r", str(first), "-c", str(count))
        assert done.returncode == 0, done.stderr
        found = {int(a): int(v) for a, v in re.findall(r"^\[(\d+)\]:\s+(-?\d+)", done.stdout, re.MULTILINE)}
        return [found[first + k] for k in range(count)]

    def write(self, first: int, *values: int) -> None:
        """FC06 of one value, FC16 of several."""
        done = self.call("-t", "4", "-r", str(first), values=values)
        assert done.returncode == 0, done.stderr
        assert f"Written {len(values)} references" in done.stdout


@contextmanager
def emulated(tmp_path: Path, kind: str) -> Iterator[Mbpoll]:
    """`rig emulate` as a user starts it."""
    command = [sys.executable, "-m", "rig", "emulate", str(CONFIG / f"modbus-{kind}.yaml")]
    if kind == "rtu":
        command += ["--link", str(tmp_path / "port")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    try:
        said = process.stdout.readline()
        named = re.search(r"emulated device on (\S+?);", said)
        assert named is not None, said or process.stderr.read()
        yield Mbpoll(named.group(1))
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
