"""The I/O block behind a virtual network: what TCP may do to a connection, and that it does no more than that."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from late_bus import LateBus, longest_reaction_s

from rig import config
from rig.backends.modbus.driver import ModbusDriver
from rig.backends.modbus.emulated.tcp_slave import Adu
from rig.backends.modbus.emulated.virtual_tcp_block import SENT_AGAIN_S, To, VirtualTcpBlock
from rig.backends.modbus.opening import modbus_driver
from rig.core.faults import Fault
from rig.running.preflight.room_to_stop import reaction_periods, stopping_rad

ROOT = Path(__file__).resolve().parents[3]
EXPERIMENT = config.load(ROOT / "config" / "modbus-tcp.yaml").model_copy(
    update={"daq": config.load(ROOT / "config" / "modbus-tcp.yaml").daq.model_copy(update={"port": "tcp://virtual"})}
)


def new_block() -> VirtualTcpBlock:
    assert EXPERIMENT.daq.modbus is not None and EXPERIMENT.emulated is not None
    return VirtualTcpBlock(EXPERIMENT.daq.modbus, EXPERIMENT.emulated)


def connected() -> VirtualTcpBlock:
    block = new_block()
    block.connect()
    return block


def driven() -> tuple[VirtualTcpBlock, ModbusDriver]:
    """Armed, and at 0.4 V for a while, a tick of 10 ms each."""
    block = connected()
    driver = modbus_driver(EXPERIMENT.device, block)
    driver.open()
    driver.arm(EXPERIMENT.device.arming)
    run_for(block, driver, 0.1)
    assert block.truth().output_V == pytest.approx(0.4, abs=2e-3)
    return block, driver


def run_for(block: VirtualTcpBlock, driver: ModbusDriver, time_s: float) -> None:
    until_s = block.now_s() + time_s
    while block.now_s() < until_s:
        driver.read()
        driver.write(0.4)
        block.sleep_until(block.now_s() + 0.01)


def fault_of(block: VirtualTcpBlock, driver: ModbusDriver) -> Fault:
    with pytest.raises(Fault) as caught:
        run_for(block, driver, 1.0)
    return caught.value


def noting(late: LateBus, block: VirtualTcpBlock) -> Callable[[bytes], None]:
    """What sends a request, and notes when."""
    write = block.write

    def noted(data: bytes) -> None:
        late("request", data, block.now_s())
        write(data)

    return noted


READ_STATUS = Adu(7, 1, bytes((3, 0, 19, 0, 1))).pack()


def test_a_request_takes_the_wire_there_the_turnaround_and_the_wire_back() -> None:
    block = connected()
    block.write(READ_STATUS)
    assert block.read(1.0) == Adu(7, 1, bytes((3, 2, 0, 0))).pack()
    assert block.now_s() == pytest.approx(0.0005 + 8 * (12 + 11) / 10e6)
    assert block.read(0.01) == b"" and block.now_s() == pytest.approx(0.0105184)


def test_requests_of_one_segment_and_half_ones_are_answered_in_order() -> None:
    block = connected()
    for piece in (READ_STATUS + READ_STATUS[:3], READ_STATUS[3:]):
        block.write(piece)
    first = block.read(1.0)
    assert first + block.read(1.0) == 2 * Adu(7, 1, bytes((3, 2, 0, 0))).pack()


@pytest.mark.parametrize("to", ["host", "device"])
def test_a_lost_packet_comes_later_and_what_follows_waits_for_it(to: To) -> None:
    block = connected()
    block.lose_packet(to)
    block.write(READ_STATUS)
    block.write(Adu(8, 1, READ_STATUS[7:]).pack())
    assert block.read(SENT_AGAIN_S) == b""
    got = block.read(1.0)
    got += block.read(0.01)
    assert got == b"".join(Adu(n, 1, bytes((3, 2, 0, 0))).pack() for n in (7, 8))
    assert block.now_s() < SENT_AGAIN_S + 0.02


def test_a_blocked_way_keeps_everything_until_it_is_free() -> None:
    block = connected()
    block.block_way("device", 0.3)
    block.write(READ_STATUS)
    assert block.read(0.29) == b"" and block.read(0.1) != b""
    block.block_way("host")
    block.write(READ_STATUS)
    assert block.read(100.0) == b""
    block.free_ways()
    assert block.read(0.01) != b""


def test_connections_end_and_a_new_one_is_made() -> None:
    block = new_block()
    with pytest.raises(Fault, match="not connected"):
        block.write(b"")
    block.connect()
    block.write(READ_STATUS)
    block.hang_up()
    with pytest.raises(Fault, match="hung up"):
        block.read(1.0)
    block.connect()
    block.reset_connection()
    with pytest.raises(Fault, match="reset by peer"):
        block.read(0.0)
    block.connect()
    block.reset(0.05)
    block.write(READ_STATUS)
    assert block.read(0.04) == b""  # it starts
    block.sleep_until(block.now_s() + 0.02)
    block.write(READ_STATUS)
    with pytest.raises(Fault, match="reset by peer"):  # of the connection it knows nothing
        block.read(0.01)
    block.connect()
    block.write(READ_STATUS)
    assert block.read(0.01) != b""
    block.write(b"no header at all")
    with pytest.raises(Fault, match="hung up"):
        block.read(0.1)
    block.block_way("host")
    began_s = block.now_s()
    with pytest.raises(Fault) as caught:
        block.connect(5.0)
    assert caught.value.code == "LINK_OPEN" and block.now_s() == pytest.approx(began_s + 5.0)


def test_drives_that_were_kept_back_drive_nothing_after_the_watchdog() -> None:
    """The network stands still for 0.3 s, then hands over what the host had said, drives and stop."""
    block, driver = driven()
    watchdog_s = EXPERIMENT.device.arming.watchdog_s
    block.block_way("device", 0.3)
    stood_s = block.now_s()
    assert fault_of(block, driver).code == "LINK_TIMEOUT"
    driver.safe_stop()
    block.sleep_until(stood_s + 0.5)
    outputs = [(t_s, u_V) for t_s, u_V in block.outputs if t_s > stood_s]
    assert [u_V for _, u_V in outputs] == [0.0]
    assert outputs[0][0] < stood_s + watchdog_s + 0.002
    assert any(not drive.taken for drive in block.executed)


def test_a_device_that_forgot_the_connection_and_one_that_never_answers() -> None:
    block, driver = driven()
    block.reset()
    assert block.truth().output_V == 0.0
    assert fault_of(block, driver).code == "LINK_LOST"
    block, driver = driven()
    block.lose_packet("host")
    assert fault_of(block, driver).code == "LINK_TIMEOUT"
    driver.safe_stop()
    block.sleep_until(block.now_s() + EXPERIMENT.device.arming.watchdog_s)
    assert block.truth().output_V == 0.0


def test_a_loop_whose_host_stands_still_reacts_within_what_the_room_to_stop_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Between exchanges, again and again: replies wait in the connection meanwhile."""
    d, longest_s = EXPERIMENT.device, 0.0
    for seed in range(40):
        block, driver = driven()
        late = LateBus(lambda driver=driver, block=block: driver._waits.left_s(block.now_s()), 0.002, 0.0, seed)  # type: ignore[misc]
        late._kind = "host"
        monkeypatch.setattr(block, "write", noting(late, block))
        longest_s = max(longest_s, longest_reaction_s(driver, block, late, d.period_s, reaction_periods(d), 0.4))
    counted_s = stopping_rad(d) / d.limits.max_speed_rad_s - d.limits.coast_tau_s
    assert 0.7 * counted_s < longest_s <= counted_s
