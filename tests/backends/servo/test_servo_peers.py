"""Both makers' packages as clients of the emulated buses: in virtual time all that they can ask, and on a terminal.

Their own port handlers wait by the machine's clock; so on the pseudo-terminal they only ask; nothing asserts a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import dynamixel_sdk as dxl
import pytest
import scservo_sdk as scs
import serial
from processes import rows, wait_until
from servo_peers import VirtualPort, violations_in

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Corruption
from rig.backends.servo import feetech
from rig.backends.servo.dynamixel import ACCESS, LENGTH, LIMIT, NO_INSTRUCTION, RANGE
from rig.backends.servo.emulated.bus import LineTimes
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.servo_board import ServoBoard
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus

AT_ONCE = {"return_delay_time": 0}
DYNAMIXELS = [
    ServoOptions(id=1, registers=AT_ONCE),
    ServoOptions(id=2, model="xl430-w250", registers=AT_ONCE | {"min_voltage_limit": 0}),
    ServoOptions(id=7, model="xm430-w350", registers=AT_ONCE | {"min_voltage_limit": 0}),
]
FEETECHS = [ServoOptions(model="sts3215", id=1), ServoOptions(model="sts3250", id=6)]
GOAL_PWM, GOAL_VELOCITY, TORQUE, LED, MODE, WATCHDOG = 100, 104, 64, 65, 11, 98
OK = dxl.COMM_SUCCESS


@pytest.fixture
def dynamixel_port() -> VirtualPort:
    return VirtualPort(VirtualServoBus(DYNAMIXELS))


@pytest.fixture
def feetech_port() -> Iterator[VirtualPort]:
    scs.PacketHandler(0)  # low byte first: a global of theirs
    yield VirtualPort(VirtualServoBus(FEETECHS))


def test_dynamixel_sdk_pings_and_scans(dynamixel_port: VirtualPort) -> None:
    sdk = dxl.Protocol2PacketHandler()
    assert sdk.ping(dynamixel_port, 1) == (1200, OK, 0)
    assert sdk.ping(dynamixel_port, 3)[1] == dxl.COMM_RX_TIMEOUT
    found, result = sdk.broadcastPing(dynamixel_port)
    assert result == OK and found == {1: [1200, 52], 2: [1060, 52], 7: [1020, 52]}


def test_dynamixel_sdk_reads_and_writes(dynamixel_port: VirtualPort) -> None:
    sdk = dxl.Protocol2PacketHandler()
    assert sdk.read1ByteTxRx(dynamixel_port, 1, 9) == (0, OK, 0)
    assert sdk.read2ByteTxRx(dynamixel_port, 1, 36) == (885, OK, 0)
    assert sdk.read4ByteTxRx(dynamixel_port, 1, 132) == (2048, OK, 0)
    assert sdk.write1ByteTxRx(dynamixel_port, 1, LED, 1) == (OK, 0)
    assert sdk.write1ByteTxOnly(dynamixel_port, 2, LED, 1) == OK
    dynamixel_port.rest()
    assert sdk.write4ByteTxRx(dynamixel_port, 1, 108, 300) == (OK, 0)
    assert sdk.read4ByteTxRx(dynamixel_port, 1, 108) == (300, OK, 0)
    data, result, error = sdk.readTxRx(dynamixel_port, 1, 120, 27)
    assert (len(data), result, error) == (27, OK, 0)


def test_dynamixel_sdk_hears_each_error(dynamixel_port: VirtualPort) -> None:
    sdk, bus = dxl.Protocol2PacketHandler(), dynamixel_port.bus.bus
    assert sdk.write1ByteTxRx(dynamixel_port, 1, TORQUE, 2) == (OK, RANGE)
    assert sdk.write1ByteTxRx(dynamixel_port, 1, GOAL_PWM, 1) == (OK, LENGTH)
    assert sdk.write4ByteTxRx(dynamixel_port, 1, GOAL_VELOCITY, 2000) == (OK, LIMIT)
    assert sdk.write2ByteTxRx(dynamixel_port, 1, 120, 0) == (OK, ACCESS)
    assert sdk.write1ByteTxRx(dynamixel_port, 1, TORQUE, 1) == (OK, 0)
    assert sdk.write1ByteTxRx(dynamixel_port, 1, MODE, 16) == (OK, ACCESS)
    assert sdk.regWriteTxRx(dynamixel_port, 1, LED, 1, [2]) == (OK, RANGE)
    assert sdk.action(dynamixel_port, 1) == OK
    dynamixel_port.rest()
    bus.servo(1).fail(0x20)
    _, result, error = sdk.ping(dynamixel_port, 1)
    assert result == OK and error == 0x80 and "Hardware error" in sdk.getRxPacketError(error)
    assert "CRC" not in sdk.getRxPacketError(NO_INSTRUCTION)


def test_dynamixel_sdk_registers_and_acts(dynamixel_port: VirtualPort) -> None:
    sdk = dxl.Protocol2PacketHandler()
    for id in (1, 2):
        assert sdk.regWriteTxRx(dynamixel_port, id, LED, 1, [1]) == (OK, 0)
    assert [sdk.read1ByteTxRx(dynamixel_port, id, LED)[0] for id in (1, 2)] == [0, 0]
    sdk.action(dynamixel_port, dxl.BROADCAST_ID)
    assert [sdk.read1ByteTxRx(dynamixel_port, id, LED)[0] for id in (1, 2)] == [1, 1]


def test_dynamixel_sdk_reads_and_writes_groups(dynamixel_port: VirtualPort) -> None:
    sdk = dxl.Protocol2PacketHandler()
    written = dxl.GroupSyncWrite(dynamixel_port, sdk, LED, 1)
    assert written.addParam(1, [1]) and written.addParam(7, [1]) and written.txPacket() == OK
    read = dxl.GroupSyncRead(dynamixel_port, sdk, LED, 1)
    for id in (7, 1, 2):
        assert read.addParam(id)
    for exchange in (read.txRxPacket, read.fastSyncRead):
        assert exchange() == OK
        assert [read.getData(id, LED, 1) for id in (1, 2, 7)] == [1, 0, 1]
    bulk = dxl.GroupBulkWrite(dynamixel_port, sdk)
    assert bulk.addParam(1, LED, 1, [0]) and bulk.addParam(2, 112, 4, [9, 0, 0, 0]) and bulk.txPacket() == OK
    back = dxl.GroupBulkRead(dynamixel_port, sdk)
    assert back.addParam(1, LED, 1) and back.addParam(2, 112, 4) and back.addParam(7, 132, 4)
    for exchange in (back.txRxPacket, back.fastBulkRead):
        assert exchange() == OK
        assert [back.getData(1, LED, 1), back.getData(2, 112, 4), back.getData(7, 132, 4)] == [0, 9, 2048]
    assert read.addParam(9) and read.txRxPacket() == dxl.COMM_RX_TIMEOUT, "nobody has this id"


def test_dynamixel_sdk_drives_and_falls_silent(dynamixel_port: VirtualPort) -> None:
    sdk, bus = dxl.Protocol2PacketHandler(), dynamixel_port.bus
    for address, value in ((MODE, 16), (TORQUE, 0), (WATCHDOG, 2)):
        assert sdk.write1ByteTxRx(dynamixel_port, 1, address, value) == (OK, 0)
    assert sdk.write2ByteTxRx(dynamixel_port, 1, GOAL_PWM, 0) == (OK, 0)
    assert sdk.write1ByteTxRx(dynamixel_port, 1, TORQUE, 1) == (OK, 0)
    for _ in range(30):
        assert sdk.write2ByteTxRx(dynamixel_port, 1, GOAL_PWM, (-400) & 0xFFFF) == (OK, 0)
        bus.sleep_until(bus.now_s() + 0.01)
    assert bus.truth().duty == -400.0
    assert sdk.read2ByteTxRx(dynamixel_port, 1, 124)[0] == (-400) & 0xFFFF
    assert sdk.read4ByteTxRx(dynamixel_port, 1, 132)[0] < 2048
    bus.sleep_until(bus.now_s() + 0.05)
    assert bus.truth().duty == 0.0 and sdk.read1ByteTxRx(dynamixel_port, 1, WATCHDOG)[0] == 0xFF
    assert sdk.write2ByteTxRx(dynamixel_port, 1, GOAL_PWM, 0) == (OK, RANGE)
    assert bus.bus.violations == []


def test_dynamixel_sdk_reboots_clears_and_resets(dynamixel_port: VirtualPort) -> None:
    sdk, bus = dxl.Protocol2PacketHandler(), dynamixel_port.bus
    bus.bus.servo(1).place(20.0)
    assert sdk.read4ByteTxRx(dynamixel_port, 1, 132)[0] > 4095
    assert sdk.clearMultiTurn(dynamixel_port, 1) == (OK, 0)
    assert sdk.read4ByteTxRx(dynamixel_port, 1, 132)[0] < 4096
    assert sdk.reboot(dynamixel_port, 1) == (OK, 0)
    assert sdk.ping(dynamixel_port, 1)[1] == dxl.COMM_RX_TIMEOUT
    bus.sleep_until(bus.now_s() + 0.5)
    assert sdk.factoryReset(dynamixel_port, 1, 2) == (OK, 0)
    bus.sleep_until(bus.now_s() + 0.5)
    assert sdk.read1ByteTxRx(dynamixel_port, 1, 9)[0] == 250


def test_scservo_sdk_pings_reads_and_writes(feetech_port: VirtualPort) -> None:
    sdk = scs.PacketHandler(0)
    assert sdk.ping(feetech_port, 1) == (777, OK, 0)
    assert sdk.ping(feetech_port, 6) == (2825, OK, 0)
    assert sdk.ping(feetech_port, 2)[1] == scs.COMM_RX_TIMEOUT
    assert sdk.read1ByteTxRx(feetech_port, 1, 62) == (50, OK, 0)
    assert sdk.read2ByteTxRx(feetech_port, 1, 56) == (2048, OK, 0)
    assert sdk.write1ByteTxRx(feetech_port, 1, 41, 9) == (OK, 0)
    assert sdk.write2ByteTxRx(feetech_port, 1, 48, 700) == (OK, 0)
    assert sdk.write2ByteTxOnly(feetech_port, 6, 48, 600) == OK
    feetech_port.rest()
    assert [sdk.read2ByteTxRx(feetech_port, id, 48)[0] for id in (1, 6)] == [700, 600]
    data, result, error = sdk.readTxRx(feetech_port, 1, 56, 15)
    assert (len(data), result, error) == (15, OK, 0)
    assert sdk.regWriteTxRx(feetech_port, 1, 41, 1, [5]) == (OK, 0)
    sdk.action(feetech_port, scs.BROADCAST_ID)
    assert sdk.read1ByteTxRx(feetech_port, 1, 41)[0] == 5


def test_scservo_sdk_reads_and_writes_groups(feetech_port: VirtualPort) -> None:
    sdk = scs.PacketHandler(0)
    written = scs.GroupSyncWrite(feetech_port, sdk, 48, 2)
    assert written.addParam(1, [0x2C, 1]) and written.addParam(6, [0x90, 1]) and written.txPacket() == OK
    read = scs.GroupSyncRead(feetech_port, sdk, 48, 2)
    assert read.addParam(6) and read.addParam(1) and read.txRxPacket() == OK
    assert [read.getData(id, 48, 2) for id in (1, 6)] == [300, 400]


def test_scservo_sdk_drives_and_hears_an_error(feetech_port: VirtualPort) -> None:
    sdk, bus = scs.PacketHandler(0), feetech_port.bus
    for address, value in ((33, 2), (41, 0)):
        assert sdk.write1ByteTxRx(feetech_port, 1, address, value) == (OK, 0)
    sdk.write2ByteTxRx(feetech_port, 1, 44, 0)
    sdk.write1ByteTxRx(feetech_port, 1, 40, 1)
    sdk.write2ByteTxRx(feetech_port, 1, 44, scs.SCS_TOSCS(-400, 10))
    bus.sleep_until(bus.now_s() + 0.3)
    assert bus.truth().duty == -400.0
    assert scs.SCS_TOHOST(sdk.read2ByteTxRx(feetech_port, 1, 60)[0], 10) == -400
    assert scs.SCS_TOHOST(sdk.read2ByteTxRx(feetech_port, 1, 58)[0], 15) < 0
    assert bus.bus.violations == []
    bus.bus.servo(1).temperature_degC = 75.0
    bus.sleep_until(bus.now_s() + 0.01)
    _, result, error = sdk.read1ByteTxRx(feetech_port, 1, 63)
    assert result == OK and "Overheat" in sdk.getRxPacketError(error) and not bus.truth().is_on
    sdk.write1ByteTxRx(feetech_port, 1, 40, 128)
    assert [v.what for v in bus.bus.violations] == ["128 to register 40: here is the middle now"]


# ---------------------------------------------------------------------- on a pseudo-terminal, with their own ports


def asked(call: Callable[[], Any], good: Callable[[Any], bool]) -> Any:
    """What it gives once it is good: a busy machine may be later than their time-out of 34 ms."""
    said: list[Any] = []

    def once() -> bool:
        said[:] = [call()]
        return good(said[0])

    wait_until(once)
    return said[0]


@pytest.mark.realtime
def test_dynamixel_sdk_on_a_terminal(tmp_path: Path) -> None:
    link, trace, noted = tmp_path / "servos", tmp_path / "trace.csv", tmp_path / "violations.csv"
    sdk = dxl.PacketHandler(2.0)
    with ServoBoard() as board:
        port_name = board.start(DYNAMIXELS, link, trace, violations=noted)
        assert str(link.readlink()) == port_name
        port = dxl.PortHandler(str(link))
        assert port.openPort() and port.setBaudRate(57_600)
        port.clearPort()
        assert sdk.ping(port, 1)[1] == dxl.COMM_RX_TIMEOUT, "they are at another baud"
        assert port.setBaudRate(1_000_000)
        assert asked(lambda: sdk.ping(port, 1), lambda said: said[1] == OK) == (1200, OK, 0)
        assert asked(lambda: sdk.broadcastPing(port)[0], lambda found: len(found) == 3).keys() == {1, 2, 7}
        for address, value in ((MODE, 16), (LED, 1)):
            asked(partial(sdk.write1ByteTxRx, port, 1, address, value), lambda said: said == (OK, 0))
        asked(lambda: sdk.write2ByteTxRx(port, 1, GOAL_PWM, 600), lambda said: said == (OK, 0))
        asked(lambda: sdk.write1ByteTxRx(port, 1, TORQUE, 1), lambda said: said == (OK, 0))
        asked(lambda: sdk.read4ByteTxRx(port, 1, 132), lambda said: said[1] == OK and said[0] > 2500)
        read = dxl.GroupSyncRead(port, sdk, 132, 4)
        assert all(read.addParam(id) for id in (1, 2, 7))
        asked(read.txRxPacket, lambda result: result == OK)
        asked(read.fastSyncRead, lambda result: result == OK)
        wait_until(lambda: violations_in(noted) == ["torque on with goal 600"])
        wait_until(lambda: any(row["y_rad"] > 1.0 and row["drive_V"] > 3.0 for row in rows(trace)))
        board.reset()
        asked(lambda: sdk.read1ByteTxRx(port, 1, LED), lambda said: said == (0, OK, 0))
        assert asked(lambda: sdk.read1ByteTxRx(port, 1, MODE), lambda said: said[1] == OK)[0] == 16
        port.closePort()
    assert not link.exists()


@pytest.mark.realtime
def test_scservo_sdk_on_a_terminal_that_damages() -> None:
    sdk = scs.PacketHandler(0)
    with ServoBoard() as board:
        port = scs.PortHandler(board.start(FEETECHS, disturbance=Corruption(3.0, 1)))
        assert port.openPort()

        def at_last(call: Callable[[], Any], good: Callable[[Any], bool]) -> int:
            """How often it was not good; what a damaged answer left in their port is dropped."""
            failed = -1

            def once() -> bool:
                nonlocal failed
                failed += 1
                port.ser.reset_input_buffer()
                return good(call())

            wait_until(once)
            return failed

        for id, number in ((1, 777), (6, 2825)):
            at_last(partial(sdk.ping, port, id), partial(_begins_with, (number, OK)))
        wait_until(lambda: at_last(partial(sdk.write1ByteTxRx, port, 1, 41, 19), lambda said: said == (OK, 0)) > 0)
        at_last(partial(sdk.read1ByteTxRx, port, 1, 41), lambda said: said == (19, OK, 0))
        port.closePort()


def _begins_with(first: tuple[int, int], said: tuple[int, ...]) -> bool:
    return said[:2] == first


@pytest.mark.realtime
def test_a_host_that_echoes_hears_itself() -> None:
    """A board that ties both lines together, at a baud of its own."""
    with ServoBoard() as board:
        name = board.start(FEETECHS, line=LineTimes(echo=True), follows_baud=False)
        with serial.Serial(name, 9600, timeout=1.0) as port:
            port.write(feetech.ping(6))
            expected = feetech.ping(6) + feetech.status(6)
            heard = b""

            def comes() -> bool:
                nonlocal heard
                heard += port.read(len(expected) - len(heard))
                return heard == expected

            wait_until(comes)


def test_a_board_that_cannot_be() -> None:
    with pytest.raises(EmulationError, match="its own"):
        ServoBoard().start([ServoOptions(), ServoOptions()])
