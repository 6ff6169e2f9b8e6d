"""Emulated devices whose process stands still for a while, in real time: no test asserts how long anything takes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from processes import PATIENCE_S

from rig.backends.links.serial_port import SerialPort
from rig.backends.registry import emulated_board
from rig.backends.serial.frames import FrameReader, Hello, Kind, encode
from rig.running.preflight import check

pytestmark = pytest.mark.realtime

CONFIG = Path(__file__).resolve().parents[2] / "config"
STALL_S = 1.2  # an Uno or a Pico catches up in some 50 ms
INTO_CATCHING_UP_S = 0.02


class Asked(NamedTuple):
    """A HELLO: sent and received in host s, and the device's time in between."""

    sent_s: float
    received_s: float
    device_s: float


class Asker:
    def __init__(self, port: SerialPort) -> None:
        self._port, self._reader, self._sent_s = port, FrameReader(), dict[int, float]()

    def send(self) -> None:
        seq = len(self._sent_s) + 1
        self._sent_s[seq] = time.monotonic()
        self._port.write(encode(Kind.HELLO, seq))

    def answer(self, patience_s: float = PATIENCE_S) -> Asked | None:
        """To the HELLO that was sent last; None without one."""
        until_s = time.monotonic() + patience_s
        while time.monotonic() < until_s:
            for packet in self._reader.feed(self._port.read(0.2)):
                if packet.kind == Kind.HELLO_REPLY and packet.seq == len(self._sent_s):
                    device_s = 1e-6 * Hello.unpack(packet.body).now_us
                    return Asked(self._sent_s[packet.seq], time.monotonic(), device_s)
        return None

    def first_answer(self) -> Asked:
        """As soon as the device listens."""
        for _ in range(round(PATIENCE_S / 0.2)):
            self.send()
            if (asked := self.answer(0.2)) is not None:
                return asked
        raise AssertionError("no reply")


@pytest.mark.parametrize("name", ["demo", "demo-chip", "demo-pico"])
def test_no_device_hears_a_request_before_it_is_sent_nor_loses_time(name: str, tmp_path: Path) -> None:
    """Neither what comes while its process stands still, nor what comes while that catches up."""
    config = yaml.safe_load((CONFIG / f"{name}.yaml").read_text("utf-8"))
    config["emulated"]["clock_error_ppm"] = 0  # so that both clocks can be compared
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config), "utf-8")
    experiment, _ = check(tmp_path / "config.yaml")
    with emulated_board(experiment.device, chip=name == "demo-chip") as board:
        port = SerialPort(board.port)
        asker = Asker(port)
        first = asker.first_answer()
        os.kill(board.pid, signal.SIGSTOP)
        time.sleep(STALL_S)
        asker.send()
        os.kill(board.pid, signal.SIGCONT)
        later = [asker.answer()]
        os.kill(board.pid, signal.SIGSTOP)
        time.sleep(STALL_S)
        os.kill(board.pid, signal.SIGCONT)
        time.sleep(INTO_CATCHING_UP_S)
        asker.send()
        later.append(asker.answer())
        port.close()
    for asked in later:
        assert asked is not None, "no reply"
        # each device time was read somewhere between question and receipt
        least_s, most_s = asked.sent_s - first.received_s, asked.received_s - first.sent_s
        assert least_s <= asked.device_s - first.device_s <= most_s
