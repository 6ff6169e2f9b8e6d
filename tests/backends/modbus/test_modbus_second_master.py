"""Two masters at one I/O block: of one machine the second is refused; one of another machine shows in the registers."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from processes import wait_until
from raised import fault_of

from rig.backends.links.held_endpoint import HeldEndpoint
from rig.backends.modbus.driver import ModbusDriver
from rig.backends.modbus.emulated.rtu_slave import check_sum
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.opening import emulated_io_block, modbus_driver
from rig.backends.registry import emulated_board, unopened
from rig.config import load
from rig.config.schema import Experiment
from rig.core.faults import Fault

CONFIGS = Path(__file__).resolve().parents[3] / "config"
STYLES = ["read-write", "separate"]
PERIOD_S = 0.01


def experiment(requests: str = "read-write", **registers: Any) -> Experiment:
    """The RTU example in virtual time; ``registers`` with None are left out."""
    data = load(CONFIGS / "modbus-rtu.yaml").model_dump(mode="json", exclude_none=True)
    data["daq"]["port"] = "emulated"
    if requests == "separate":
        data["period_s"], data["daq"]["watchdog_s"] = 0.02, 0.2
    section = data["daq"]["modbus"] | {"requests": requests}
    section["registers"] = {k: v for k, v in (section["registers"] | registers).items() if v is not None}
    data["daq"]["modbus"] = section
    return Experiment.model_validate(data)


class OtherMachine:
    """Another rig that drives the same block every period, from ``begin`` to ``end``; its requests take no time."""

    def __init__(self, block: VirtualIoBlock, e: Experiment) -> None:
        self._block, self._e = block, e
        self._due_s, self._waited_s, self._answer = math.inf, 0.0, b""
        self._driver = modbus_driver(e.device, self)
        run_to = block._run_to

        def both(t_s: float) -> None:
            while self._due_s <= t_s:
                run_to(self._due_s)
                self._due_s += PERIOD_S
                self._drive()
            run_to(t_s)

        block._run_to = both  # type: ignore[method-assign]  # of this block alone

    def begin(self, watchdog_s: float = 0.1) -> None:
        self._driver.arm(replace(self._e.device.arming, watchdog_s=watchdog_s))
        self._drive()
        self._drive()
        self._due_s = self._block.now_s() + PERIOD_S

    def end(self) -> None:
        self._due_s = math.inf

    def _drive(self) -> None:
        with suppress(Fault):  # of what this machine does to it
            self._driver.write(0.6)
            self._driver.read()

    def write(self, data: bytes) -> None:
        reply = data[:1] + self._block.block.request(data[1:-2], self._block.now_s())
        self._answer = reply + check_sum(reply)

    def read(self, timeout_s: float) -> bytes:
        self._waited_s += 0.0 if self._answer else timeout_s
        answer, self._answer = self._answer, b""
        return answer

    def now_s(self) -> float:
        return self._block.now_s() + self._waited_s

    def close(self) -> None:
        pass


class Rig:
    """The driver of this machine, and another machine at the same block."""

    def __init__(self, e: Experiment) -> None:
        self.e, self.block = e, emulated_io_block(e.device)
        self.other = OtherMachine(self.block, e)
        self.driver: ModbusDriver = modbus_driver(e.device, self.block)

    def ticks(self, number: int) -> None:
        for _ in range(number):
            self.block.sleep_until(self.block.now_s() + self.e.period_s)
            self.driver.read()
            self.driver.write(0.3)


MAPS: dict[str, dict[str, Any]] = {
    "whole": {},
    "no echo": {"sequence": None},
    "status alone": {"sequence": None, "applied": None},
    "applied alone": {"sequence": None, "status": None, "control": None},
    "echo alone": {"applied": None, "status": None, "control": None},
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("style", STYLES)
def test_a_block_that_another_machine_drives_is_found_before_anything_is_written_to_it(style: str, name: str) -> None:
    rig = Rig(experiment(style, **MAPS[name]))
    rig.other.begin()
    before = rig.block.truth().output_V
    assert before != 0.0
    fault = fault_of(rig.driver.open)
    assert fault.code == "SECOND_MASTER", fault
    assert not rig.driver.safe_stop(), "nothing is known of a stop"
    assert rig.block.truth().output_V == pytest.approx(before, rel=0.01), "the other one's drive is its own"


def test_a_block_that_tells_nothing_of_a_second_master_is_opened() -> None:
    """As docs/modbus.md says: with neither echo nor applied nor status there is nothing to see."""
    rig = Rig(experiment(sequence=None, applied=None, status=None))
    rig.other.begin()
    rig.driver.open()


@pytest.mark.parametrize("name", MAPS)
def test_what_a_killed_master_has_left_armed_is_opened(name: str) -> None:
    """Its watchdog ends it in the silence; nobody is there who could be disturbed."""
    rig = Rig(experiment(**MAPS[name]))
    rig.other.begin(0.9)
    rig.block.sleep_until(rig.block.now_s() + 0.03)
    rig.other.end()
    rig.driver.open()
    rig.driver.arm(rig.e.device.arming)
    rig.ticks(5)


@pytest.mark.parametrize("style", STYLES)
def test_another_machine_that_comes_in_a_pause_ends_the_run(style: str) -> None:
    for name in ("whole", "no echo", "echo alone"):
        rig = Rig(experiment(style, **MAPS[name]))
        rig.driver.open()
        rig.driver.arm(rig.e.device.arming)
        rig.ticks(20)
        assert rig.driver.safe_stop()
        rig.driver.read()
        rig.other.begin()

        def pause(rig: Rig = rig) -> None:
            for _ in range(4):
                rig.block.sleep_until(rig.block.now_s() + rig.e.period_s)
                rig.driver.read()

        assert fault_of(pause).code == "SECOND_MASTER"


def test_drives_of_another_machine_between_ones_own_are_told_from_a_late_reply() -> None:
    rig = Rig(experiment("separate"))
    rig.driver.open()
    rig.driver.arm(rig.e.device.arming)
    rig.ticks(20)
    rig.other.begin()
    assert fault_of(rig.ticks, 3).code == "SECOND_MASTER"
    assert rig.driver.safe_stop()


# ---------------------------------------------------------------------- of this machine


@pytest.fixture(scope="module")
def block() -> Iterator[int]:
    """The port number of an emulated block on Modbus TCP."""
    with emulated_board(load(CONFIGS / "modbus-tcp.yaml").device) as board:
        yield int(board.port.rpartition(":")[2])


def at(host: str, port: int, unit: int = 1) -> Experiment:
    e = load(CONFIGS / "modbus-tcp.yaml")
    assert e.daq.modbus is not None
    modbus = e.daq.modbus.model_copy(update={"unit": unit})
    return e.model_copy(update={"daq": e.daq.model_copy(update={"port": f"tcp://{host}:{port}", "modbus": modbus})})


def own_addresses() -> list[str]:
    names = ["localhost", "127.0.0.1", socket.gethostname()]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # sends nothing: it asks which address would be used
        return [*names, probe.getsockname()[0], "::1", "[::ffff:127.0.0.1]".strip("[]")]


@pytest.mark.parametrize("first", own_addresses())
def test_each_name_of_this_machine_is_one_device(first: str) -> None:
    held = HeldEndpoint(first, 15020, 1)
    try:
        for second in own_addresses():
            fault = fault_of(HeldEndpoint, second, 15020, 1)
            assert fault.code == "SECOND_MASTER"
            assert f"process {os.getpid()} (" in fault.detail and fault.detail.endswith(" holds it")
        for other in ((15021, 1), (15020, 2)):
            HeldEndpoint(first, *other).close()
    finally:
        held.close()
    HeldEndpoint(first, 15020, 1).close()


def test_a_device_elsewhere_is_one_by_each_way_to_write_its_address() -> None:
    for one, other in (("192.0.2.7", "::ffff:192.0.2.7"), ("2001:db8::7", "2001:0db8:0::0007")):
        held = HeldEndpoint(one, 502, 1)
        assert fault_of(HeldEndpoint, other, 502, 1).code == "SECOND_MASTER"
        HeldEndpoint("192.0.2.8", 502, 1).close()
        held.close()
    assert fault_of(HeldEndpoint, "no.such.name.invalid", 502, 1).code == "LINK_OPEN"


def test_a_second_driver_on_this_machine_is_refused_and_the_first_goes_on(block: int) -> None:
    with unopened(at("127.0.0.1", block).device) as (driver, *_):
        driver.open()
        fault = fault_of(unopened(at("localhost", block).device).__enter__)
        assert fault.code == "SECOND_MASTER"
        driver.read()
        driver.close()
    with unopened(at("localhost", block).device) as (driver, *_):
        driver.open()
        driver.close()


_HOLDS = """
import sys, time
from pathlib import Path
from rig.backends.links.held_endpoint import HeldEndpoint
from rig.run_folder.live.stop_flag import StopFlag
flag = StopFlag()
flag.begin(Path(sys.argv[2]))
held = HeldEndpoint("127.0.0.1", int(sys.argv[1]), 1)
print("holds", flush=True)
time.sleep(600)
"""


def test_a_killed_master_holds_nothing_and_one_that_lives_is_named_with_its_run(tmp_path: Path) -> None:
    folder = tmp_path / "20260101T000000Z-run-bench"
    folder.mkdir()
    command = [sys.executable, "-c", _HOLDS, "15022", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None and other.stdout.readline() == "holds\n"
            detail = fault_of(HeldEndpoint, "localhost", 15022, 1).detail
            assert f"process {other.pid} (" in detail and f"run folder {folder} holds it" in detail
        finally:
            other.send_signal(signal.SIGKILL)

        def is_free() -> bool:
            try:
                HeldEndpoint("localhost", 15022, 1).close()
            except Exception:  # noqa: BLE001 - the kernel has not yet ended it
                return False
            return True

        wait_until(is_free)
