"""The Modbus driver against the emulated I/O block in virtual time: what it drives, and every fault of a reply."""

from __future__ import annotations

import itertools
import math
import random
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from evidence import evidence
from late_bus import LateBus, longest_reaction_s
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

from rig.backends.emulated.line_faults import Corruption, Direction
from rig.backends.modbus.client import Modbus, ModbusLine
from rig.backends.modbus.driver import ModbusDriver
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import check_sum
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.opening import emulated_io_block, modbus_driver
from rig.backends.modbus.requests import Request
from rig.backends.registers.bus import BusClient
from rig.config import load
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.running.preflight.room_to_stop import reaction_periods, stopping_rad

CONFIG = Path(__file__).resolve().parents[3] / "config" / "modbus-rtu.yaml"
STYLES = ["read-write", "separate"]


def experiment_with(requests: str = "read-write", registers: dict[str, Any] | None = None, **modbus: Any) -> Experiment:
    """The RTU example in virtual time; ``registers`` with None are left out. Separate requests take 20 ms a tick."""
    data = load(CONFIG).model_dump(mode="json", exclude_none=True)
    data["daq"] |= {"port": "emulated"}
    if requests == "separate":
        data["period_s"] = 0.02
        data["daq"]["watchdog_s"] = 0.2
    section = data["daq"]["modbus"] | {"requests": requests} | modbus
    section["registers"] = {k: v for k, v in (section["registers"] | (registers or {})).items() if v is not None}
    data["daq"]["modbus"] = section
    return Experiment.model_validate(data)


class Rig:
    """Driver and block, and ticks on a grid."""

    def __init__(self, experiment: Experiment, *, armed: bool = True) -> None:
        self.experiment = experiment
        self.block: VirtualIoBlock = emulated_io_block(experiment.device)
        self.driver: ModbusDriver = modbus_driver(experiment.device, self.block)
        self.commanded: set[int] = {0}
        self.driver.open()
        self._due_s = self.block.now_s()
        if armed:
            self.arm()

    def arm(self) -> None:
        self.driver.arm(self.experiment.device.arming)
        self._due_s = self.block.now_s()

    def tick(self, u_V: float) -> Sample:
        self._due_s += self.experiment.period_s
        self.block.sleep_until(self._due_s)
        sample = self.driver.read()
        self.commanded.add(self.driver.drive_map.to_units(u_V))
        self.driver.write(u_V)
        return sample

    def fault_while_driving(self, ticks: int = 30) -> Fault:
        """The fault that ends a run at 0.6 V."""
        with pytest.raises(Fault) as caught:
            for _ in range(ticks):
                self.tick(0.6)
        return caught.value

    @property
    def driven(self) -> set[int]:
        """Every drive that the block took."""
        return {round(drive.value) for drive in self.block.executed if drive.taken}


@pytest.fixture(params=STYLES)
def rig(request: pytest.FixtureRequest) -> Rig:
    return Rig(experiment_with(request.param))


# ---------------------------------------------------------------------- what it does


def test_a_drive_acts_when_the_sample_says(rig: Rig) -> None:
    """The block's own log of its output against the times that the driver gives."""
    period_s = rig.experiment.period_s
    for k in range(20):
        rig.tick(0.3 if k % 2 else -0.3)
    sample = rig.tick(0.0)
    for _ in range(3):
        acting_s, acting_V = [output for output in rig.block.outputs if output[0] <= sample.t_u_s + 1e-3][-1]
        # within half the turnaround, whose middle is assumed
        assert sample.t_u_s == pytest.approx(acting_s, abs=0.5 * 0.0005 + 1e-9)
        assert acting_V == pytest.approx(sample.u_V)
        sample = rig.tick(0.3 if sample.u_V <= 0.0 else -0.3)
    first_first = rig.driver.order == "write_first"
    previous = rig.tick(0.25)
    following = rig.tick(0.25)
    latency_s = following.t_u_s - previous.t_s
    if first_first:
        assert latency_s == pytest.approx(period_s, abs=1e-6)  # it goes out with the next exchange, at whose instant
        assert following.t_u_s == following.t_s  # it is sampled, too
    else:
        assert 0.003 < latency_s < 0.01
        assert following.t_u_s < following.t_s


@pytest.mark.parametrize("held_up_s", [0.0, 0.0005, 0.002])
def test_a_reply_that_was_held_up_does_not_move_the_instant(rig: Rig, held_up_s: float) -> None:
    """Bytes leave at once; what an exchange takes too long the reply was under way. Sampled and driven is in time."""
    for k in range(5):
        rig.tick(0.3 if k % 2 else -0.3)
    rig.block.disturb(OneReply(lambda data: [(held_up_s, data)]))
    sample = rig.tick(0.3)
    rig.block.disturb(None)
    if rig.driver.order == "write_first":
        assert sample.t_s == pytest.approx(rig.block.outputs[-1][0], abs=0.5 * 0.0005 + 1e-9)
    assert rig.tick(0.3).t_s - sample.t_s == pytest.approx(rig.experiment.period_s, abs=1e-9)


def round_trip_while_opening(style: str, spoil: Callable[[VirtualIoBlock, int], None]) -> float:
    """What the driver takes for the exchange's time, s; ``spoil`` gets the block and the number of each request."""
    experiment = experiment_with(style)
    block = emulated_io_block(experiment.device)
    write, sent = block.write, itertools.count()

    def writing(data: bytes) -> None:
        write(data)
        spoil(block, next(sent))

    block.write = writing  # type: ignore[method-assign]
    return modbus_driver(experiment.device, block).open().round_trip_s


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("late_s", [0.0003, 0.001, 0.0018, 0.0026, 0.004, 0.006, 0.012])
def test_a_reply_that_comes_twice_or_a_host_that_stands_still_while_it_opens_moves_no_time(
    style: str, late_s: float
) -> None:
    def comes_twice(block: VirtualIoBlock, number: int) -> None:
        if number == 9:
            block.disturb(OneReply(lambda data: [(0.0, data), (late_s, data)]))

    def stands_still(block: VirtualIoBlock, number: int) -> None:
        if number in (9, 10):
            block.sleep_until(block.now_s() + late_s)

    undisturbed_s = round_trip_while_opening(style, lambda *_: None)
    for spoil in (comes_twice, stands_still):
        assert round_trip_while_opening(style, spoil) == pytest.approx(undisturbed_s, abs=1e-5)


@pytest.mark.parametrize("before", [True, False], ids=["before the request left", "after that"])
def test_a_host_that_stands_still_while_it_sends_does_not_move_the_instant(rig: Rig, before: bool) -> None:
    for k in range(10):
        rig.tick(0.6 if k % 2 else -0.6)
    write, stalls = rig.block.write, [0.05]

    def late_write(data: bytes) -> None:
        if before and stalls:
            rig.block.sleep_until(rig.block.now_s() + stalls.pop())
        write(data)
        if stalls:
            rig.block.sleep_until(rig.block.now_s() + stalls.pop())

    rig.driver.write(0.3)
    rig.block.write = late_write  # type: ignore[method-assign]
    asked_s = rig.block.now_s()
    sample = rig.driver.read()
    executed_s = asked_s + (0.05 if before else 0.0)
    assert executed_s < sample.t_s < executed_s + 0.01
    if rig.driver.order == "write_first":
        assert sample.t_s == pytest.approx(rig.block.outputs[-1][0], abs=0.5 * 0.0005 + 1e-9)


@pytest.mark.parametrize("silence_s", [0.0001, 0.001])
def test_a_device_that_is_quicker_than_the_sum_is_not_taken_for_late(silence_s: float) -> None:
    """It is content with less silence than the config says: by so much its drives act earlier, all of them alike."""
    rig = Rig(experiment_with(), armed=False)
    rig.block._slave.line = replace(rig.block.line, silence_s=silence_s)
    rig.driver.open()
    rig.arm()
    rig.tick(-0.3)
    offs_s = []
    for k in range(10):
        rig.block.disturb(OneReply(lambda data, k=k: [(2e-4 * (k % 3), data)]))
        sample = rig.tick(0.3 if k % 2 else -0.3)
        offs_s.append(sample.t_u_s - rig.block.outputs[-1][0])
    offs_s = offs_s[2:]
    assert max(map(abs, offs_s)) < 0.0005
    assert max(offs_s) - min(offs_s) < 1e-4


def test_what_is_read_is_what_is_there(rig: Rig) -> None:
    rig.block.block.bench.parameters = rig.block.block.bench.parameters.__class__(
        motor=rig.block.block.bench.parameters.motor
    )
    for y_rad in (-1.0, -0.3, 0.0, 0.7):
        rig.block.place(y_rad)
        assert rig.tick(0.0).y_rad == pytest.approx(y_rad, abs=0.6 * rig.driver.calibration.lsb_rad)


@pytest.mark.parametrize(("kind", "told"), [("float32", 443029.2), ("int32", -5), ("uint16", 1024)])
def test_a_position_that_no_sensor_gives_is_refused_by_name_before_anything_is_armed(kind: str, told: float) -> None:
    """What 5.03 is with its words swapped; a negative reading; one beyond the converter."""
    absent = dict.fromkeys(("sequence", "applied", "status", "limits", "rails"))
    experiment = experiment_with(registers={"position": {"address": 16, "type": kind}} | absent)
    block = emulated_io_block(experiment.device)
    driver = modbus_driver(experiment.device, block)
    data = struct.pack({"float32": ">f", "int32": ">i", "uint16": ">H"}[kind], told)

    def telling(direction: Direction, frame: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        return [(0.0, frame if direction == "request" or frame[1] != 3 else signed(frame[:3] + data))]

    block.disturb(telling)
    with pytest.raises(Fault, match="CONFIG_MISMATCH") as caught:
        driver.open()
    for words in ("position, holding register", "sensor.counts_max", "word_order"):
        assert words in caught.value.detail
    assert not block.executed


def test_before_arming_it_reads_and_drives_nothing() -> None:
    for style in STYLES:
        rig = Rig(experiment_with(style), armed=False)
        assert math.isnan(rig.driver.read().t_u_s)
        with pytest.raises(Fault, match="DEVICE_NOT_ARMED"):
            rig.driver.write(0.5)
        rig.driver.read()
        assert not any(drive.value for drive in rig.block.executed)


def test_arming_writes_limits_rounded_inward_and_reads_them_back(rig: Rig) -> None:
    values = rig.block.block._values
    low, high = (rig.driver.calibration.to_counts(y) for y in rig.experiment.limits.hard_rad)
    assert (values["limits.low"], values["limits.high"]) == (math.ceil(low), math.floor(high))
    rail_low, rail_high = rig.experiment.sensor.rails
    assert (values["rails.low"], values["rails.high"]) == (rail_low, rail_high)
    assert values["watchdog"] == round(1000 * rig.experiment.daq.watchdog_s)
    assert values["max_drive"] == rig.driver.drive_map.to_units(rig.experiment.drive.max_V)
    assert rig.driver.failsafe is not None
    assert rig.driver.failsafe.time_s == rig.experiment.daq.watchdog_s


def test_a_setting_that_the_device_changes_is_no_arming() -> None:
    rig = Rig(experiment_with(), armed=False)
    real = rig.block.block._write

    def rounding(values: dict[str, float]) -> None:
        real({k: 90.0 if k == "watchdog" else v for k, v in values.items()})

    rig.block.block._write = rounding  # type: ignore[method-assign]  # of this block alone
    with pytest.raises(Fault, match=r"ARM_READBACK.*watchdog, holding register 9: sent 120, stored 90"):
        rig.arm()


def test_beyond_what_was_armed_nothing_goes_out(rig: Rig) -> None:
    for u_V in (3.1, -3.1, 12.5, math.nan, math.inf):
        with pytest.raises(ValueError, match="beyond"):
            rig.driver.write(u_V)
    rig.tick(0.0)
    assert rig.driven == {0}


def test_stop_is_confirmed_by_the_registers(rig: Rig) -> None:
    for _ in range(5):
        rig.tick(0.6)
    assert rig.block.truth().output_V != 0.0
    assert rig.driver.safe_stop()
    truth = rig.block.truth()
    assert (truth.output_V, truth.armed) == (0.0, False)
    rig.arm()  # and again
    rig.tick(0.4)
    rig.tick(0.4)
    assert rig.block.truth().output_V != 0.0


@pytest.mark.parametrize("without", [None, "applied", "status"])
@pytest.mark.parametrize("style", STYLES)
def test_a_block_that_goes_on_driving_does_not_confirm_the_stop(style: str, without: str | None) -> None:
    """It answers as if it stopped; either of the registers that tell of it says what it does."""
    rig = Rig(experiment_with(style, {} if without is None else {without: None}))
    rig.tick(0.6)
    rig.tick(0.6)
    real = rig.block.block.request

    def deaf(pdu: bytes, t_s: float) -> bytes:
        return pdu if pdu[0] == 6 else b"\x10" + pdu[1:5] if pdu[0] == 16 else real(pdu, t_s)

    rig.block.block.request = deaf  # type: ignore[method-assign]  # of this block alone
    assert not rig.driver.safe_stop()
    assert rig.block.truth().output_V != 0.0


def test_a_block_that_takes_no_drive_while_it_is_stopped_is_stopped(rig: Rig) -> None:
    """Not even 0: some are so, and the registers confirm the stop."""
    rig.tick(0.6)
    rig.tick(0.6)
    real = rig.block.block.request

    def choosy(pdu: bytes, t_s: float) -> bytes:
        return bytes((0x80 | pdu[0], 4)) if pdu[0] == 16 else real(pdu, t_s)

    rig.block.block.request = choosy  # type: ignore[method-assign]  # of this block alone
    assert rig.driver.safe_stop()
    assert rig.block.truth().output_V == 0.0


def test_an_exchange_quicker_than_the_fastest_so_far_was_executed_on_its_way() -> None:
    """Never after its reply: the share of the way there is the config's, of what the exchange really took."""

    class Quick:
        """Answers a read of one register over TCP after 0.2 ms, of 0.5 ms that the config gives a turnaround."""

        t_s, reply = 100.0, b""

        def now_s(self) -> float:
            return self.t_s

        def write(self, data: bytes) -> None:
            self.reply = data[:4] + b"\0\5\1\3\2\0\7"

        def read(self, timeout_s: float) -> bytes:
            data, self.reply = self.reply, b""
            self.t_s += 0.2e-3 if data else timeout_s
            return data

        def close(self) -> None:
            pass

    client = BusClient(Quick(), Modbus(ModbusLine(tcp=True)))
    request = Request(ReadHoldingRegistersRequest(address=0, count=1), "a register")
    reply = client.asked(request, 0.01)
    assert reply.round_trip_s == pytest.approx(0.2e-3)
    assert reply.executed_s - 100.0 == pytest.approx(0.1e-3)


def test_arming_sets_the_drive_to_0_before_it_arms() -> None:
    """A block may keep the drive of an earlier run in its register."""
    rig = Rig(experiment_with(), armed=False)
    real, written = rig.block.block._write, []

    def watching(values: dict[str, float]) -> None:
        written.append(values)
        real(values)

    rig.block.block._write = watching  # type: ignore[method-assign]  # of this block alone
    rig.arm()
    assert written[-1] == {"control": 1.0} and written[-2]["drive"] == 0.0 and "sequence" in written[-2]


def test_a_stop_of_a_dead_device_is_not_confirmed_and_is_bounded(rig: Rig) -> None:
    rig.tick(0.6)
    rig.tick(0.6)
    rig.block.inject(ReplyFault("silent"))
    from_s = rig.block.now_s()
    assert not rig.driver.safe_stop()
    assert rig.block.now_s() - from_s < 0.15
    rig.block.inject(None)
    rig.block.sleep_until(rig.block.now_s() + rig.experiment.daq.watchdog_s)
    assert rig.block.truth().output_V == 0.0  # the device's own watchdog


def test_a_device_that_refuses_to_stop_is_driven_to_0_all_the_same(rig: Rig) -> None:
    """The stop is not confirmed then, but nothing turns."""
    for _ in range(3):
        rig.tick(0.6)
    real = rig.block.block.request

    def refusing(pdu: bytes, t_s: float) -> bytes:
        return b"\x86\x06" if pdu[:3] == b"\x06\x00\x08" else real(pdu, t_s)  # control, register 8: busy

    rig.block.block.request = refusing  # type: ignore[method-assign]  # of this block alone
    assert not rig.driver.safe_stop()
    assert rig.block.truth().output_V == 0.0
    assert [drive.value for drive in rig.block.executed][-1] == 0.0


@pytest.mark.parametrize("cycles", [1, 4])
def test_a_device_that_takes_its_time_to_be_armed_is_waited_for(cycles: int) -> None:
    """Its status is of the cycle before, as that of a device with a program of its own."""
    rig = Rig(experiment_with(), armed=False)
    left = cycles

    def still_off(direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        nonlocal left
        if direction == "reply" and data[1] == 3 and len(data) == 13 and rig.block.truth().armed and left > 0:
            left -= 1
            data = signed(data[:9] + bytes(2))
        return [(0.0, data)]

    rig.block.disturb(still_off)
    rig.arm()
    assert left == 0
    rig.tick(0.3)
    rig.tick(0.3)
    assert rig.block.truth().output_V != 0.0
    left = 10**6
    with pytest.raises(Fault, match="DEVICE_RESET") as caught:
        rig.arm()
    assert "status, holding register 19 reads 0: not armed" in caught.value.detail


def test_a_plug_that_is_pulled_is_a_fault_and_no_exception_while_stopping(rig: Rig) -> None:
    rig.tick(0.5)
    rig.block.unplug()
    assert rig.fault_while_driving().code == "LINK_LOST"
    assert not rig.driver.safe_stop()
    rig.driver.close()
    rig.driver.close()


# ---------------------------------------------------------------------- every fault of a reply


class OneReply:
    """Replaces the reply to one request by what ``forged`` makes of it; from when it is set."""

    def __init__(self, forged: Any) -> None:
        self._forged = forged
        self.done = False

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        if direction == "request" or self.done:
            return ((0.0, data),)
        self.done = True
        forged: Sequence[tuple[float, bytes]] = self._forged(data)
        return forged


def signed(body: bytes) -> bytes:
    return body + check_sum(body)


FORGED: dict[str, tuple[Any, str, str]] = {
    "late": (lambda d: [(0.25, d)], "LINK_TIMEOUT", "no reply from unit 1"),
    "none": (lambda d: [], "LINK_TIMEOUT", "position, holding register 16"),
    "cut short": (lambda d: [(0.0, d[:-3])], "LINK_REPLY", "no whole reply"),
    "first byte lost": (lambda d: [(0.0, d[1:])], "LINK_REPLY", ""),
    "a bit": (lambda d: [(0.0, d[:4] + bytes((d[4] ^ 1,)) + d[5:])], "LINK_REPLY", "check sum"),
    "check sum": (lambda d: [(0.0, d[:-1] + bytes((d[-1] ^ 255,)))], "LINK_REPLY", "check sum"),
    "function": (lambda d: [(0.0, signed(bytes((d[0], 4)) + d[2:-2]))], "LINK_REPLY", "the reply is of FC04"),
    "no function": (lambda d: [(0.0, signed(bytes((d[0], 99)) + d[2:-2]))], "LINK_REPLY", "function code 99"),
    "byte count": (lambda d: [(0.0, signed(bytes((d[0], d[1], d[2] - 2)) + d[3:-4]))], "LINK_REPLY",
                   "6 bytes came, not 8"),
    "another unit": (lambda d: [(0.0, signed(bytes((7,)) + d[1:-2]))], "LINK_UNIT", "unit 7 answered"),
    "exception": (lambda d: [(0.0, signed(bytes((d[0], d[1] | 0x80, 2))))], "MODBUS_EXCEPTION",
                  "illegal data address (2) at"),
    "exception of another": (lambda d: [(0.0, signed(bytes((d[0], 0x90, 2))))], "LINK_REPLY", "FC144"),
    "stale echo": (lambda d: [(0.0, signed(d[:5] + bytes((d[5], d[6] ^ 1)) + d[7:-2]))], "LINK_REPLY",
                   "echo, holding register 17"),
    "twice at once": (lambda d: [(0.0, d + d)], "LINK_REPLY", "two answers to one request"),
    "twice": (lambda d: [(0.0, d), (0.002, d)], "LINK_REPLY", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED)
@pytest.mark.parametrize("style", STYLES)
def test_a_reply_that_is_not_the_reply_is_a_fault_and_the_motor_stops(style: str, name: str) -> None:
    forged, code, words = FORGED[name]
    rig = Rig(experiment_with(style))
    for _ in range(10):
        rig.tick(0.6)
    rig.block.disturb(OneReply(forged))
    fault = rig.fault_while_driving(2)
    assert fault.code == code, fault
    assert words in fault.detail
    assert rig.driver.safe_stop()
    truth = rig.block.truth()
    assert (truth.output_V, truth.armed) == (0.0, False)
    assert rig.driven == rig.commanded


@pytest.mark.parametrize("kind", ["late", "wrong", "exception", "unit", "silent"])
@pytest.mark.parametrize("style", STYLES)
def test_a_device_that_goes_on_misbehaving_ends_at_0_V(style: str, kind: Any) -> None:
    """It never confirms, or does so late; its output is 0 V by a stop that arrived, or by its watchdog."""
    rig = Rig(experiment_with(style))
    for _ in range(10):
        rig.tick(0.6)
    rig.block.inject(ReplyFault(kind, by_s=0.25))
    fault = rig.fault_while_driving(2)
    expected = {
        "late": "LINK_TIMEOUT", "wrong": "LINK_REPLY", "exception": "MODBUS_EXCEPTION", "unit": "LINK_UNIT",
        "silent": "LINK_TIMEOUT",
    }  # fmt: skip
    assert fault.code == expected[kind]
    assert not rig.driver.safe_stop()
    stopped_s = rig.block.now_s()
    rig.block.sleep_until(stopped_s + rig.experiment.daq.watchdog_s)
    assert rig.block.truth().output_V == 0.0
    assert rig.driven == rig.commanded


@pytest.mark.parametrize("by_s", [0.012, 0.05, 0.085])
def test_a_late_reply_is_waited_for_as_long_as_the_watchdog_lets_the_drive_act(rig: Rig, by_s: float) -> None:
    """It is taken with the time at which the block executed the request, and the next request gets its own reply."""
    for k in range(10):
        rig.tick(0.6 if k % 2 else -0.6)
    rig.block.inject(ReplyFault("late", times=1, by_s=by_s))
    sent_s = rig.block.now_s()
    late = rig.tick(0.3)
    assert rig.block.now_s() - sent_s > by_s and late.t_s - sent_s < rig.experiment.period_s + 0.01
    for k in range(10):
        sample = rig.tick(0.6 if k % 2 else -0.6)
        assert rig.block.now_s() - sample.t_s < rig.experiment.period_s
    assert rig.driver.link_statistics["timeouts"] == 0 and rig.block.truth().output_V != 0.0


def test_replies_that_are_late_one_after_the_other_end_the_run(rig: Rig) -> None:
    """Else a link that is not fit for the period would drive the motor on and on, each drive many periods old."""
    for k in range(10):
        rig.tick(0.6 if k % 2 else -0.6)
    rig.block.inject(ReplyFault("late", times=2, by_s=0.03))
    for k in range(10):  # two in a row are borne
        rig.tick(0.6 if k % 2 else -0.6)
    rig.block.inject(ReplyFault("late", times=3, by_s=0.03))
    fault = rig.fault_while_driving(3)
    assert fault.code == "LINK_TIMEOUT" and "3 replies in a row took over" in fault.detail


def test_a_host_that_stands_still_again_while_a_loop_reacts_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each time the reply had come meanwhile, so nothing was waited for; with FC23 no other exchange is in its tick."""
    rig = Rig(experiment_with())
    rig.arm()
    write = rig.block.write
    stands_s = iter([0.0, 0.09, 0.0, 0.0, 0.0, 0.0, 0.09, 0.0, 0.09, 0.0])  # once is borne, now and then

    def stands_still(data: bytes) -> None:
        write(data)
        rig.block.sleep_until(rig.block.now_s() + next(stands_s, 0.0))

    monkeypatch.setattr(rig.block, "write", stands_still)
    fault = rig.fault_while_driving(10)
    assert "all that `rig check` counts" in fault.detail and list(stands_s) == [0.0]


def test_a_host_that_stood_still_behind_its_request_until_the_watchdog_has_acted_is_told_so(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its reply, of before that, had come meanwhile: LINK_TIMEOUT told of replies that were late."""
    rig.tick(0.6)
    write, stands_s = rig.block.write, iter([0.0, 1.0])

    def stands_still(data: bytes) -> None:
        write(data)
        rig.block.sleep_until(rig.block.now_s() + next(stands_s, 0.0))

    monkeypatch.setattr(rig.block, "write", stands_still)
    assert rig.fault_while_driving(4).code == "DEVICE_WATCHDOG"


def test_where_the_watchdog_should_have_acted_and_the_next_reading_is_armed_the_run_ends(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a device drives on, and did so for three ticks more, of which none was late."""
    monkeypatch.setattr(type(rig.block.block), "watchdog_s", None)
    rig.tick(0.6)
    write, stands_s, stood_s = rig.block.write, iter([0.0, 1.0]), 0.0

    def stands_still(data: bytes) -> None:
        nonlocal stood_s
        write(data)
        if (left_s := next(stands_s, 0.0)) > 0.0:
            rig.block.sleep_until(stood_s := rig.block.now_s() + left_s)

    monkeypatch.setattr(rig.block, "write", stands_still)
    fault = rig.fault_while_driving(9)
    assert fault.code == "LINK_TIMEOUT" and "all that `rig check` counts" in fault.detail
    assert 0.0 <= rig.block.now_s() - stood_s < rig.experiment.period_s


@pytest.mark.parametrize("at", [3, 5], ids=["address", "how many"])
def test_a_write_that_is_confirmed_otherwise_is_a_fault(at: int) -> None:
    """Asked separately the drive goes out by FC16, whose reply repeats where and how many registers."""
    rig = Rig(experiment_with("separate"))
    for _ in range(3):
        rig.tick(0.6)

    def otherwise(direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        if direction == "reply" and data[1] == 16:
            data = signed(data[:at] + bytes((data[at] ^ 1,)) + data[at + 1 : -2])
        return ((0.0, data),)

    rig.block.disturb(otherwise)
    fault = rig.fault_while_driving(2)
    assert fault.code == "LINK_REPLY" and "confirmed is 10" in fault.detail


def test_a_late_reply_is_no_confirmation_of_the_stop() -> None:
    """Separate requests, 32-bit drive: the stop's FC16 looks like the tick's, whose reply is late."""
    registers = {
        "drive": {"address": 0, "type": "int32", "full": 10000}, "sequence": None, "control": None, "status": None,
        "applied": None, "max_drive": {"address": 30},
    }  # fmt: skip
    rig = Rig(experiment_with("separate", registers))
    rig.tick(0.6)
    # the write of the tick is answered when its tick has given up; after that the block hears nothing any more
    deaf = False

    def late_then_deaf(direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        nonlocal deaf
        if direction == "request":
            return () if deaf else ((0.0, data),)
        if data[1] == 16:
            deaf = True
            return ((rig.experiment.daq.watchdog_s, data),)
        return ((0.0, data),)

    rig.block.disturb(late_then_deaf)
    assert rig.fault_while_driving(2).code == "LINK_TIMEOUT"
    assert not rig.driver.safe_stop()
    assert rig.driver.link_statistics["stale_bytes"] >= 8


@pytest.mark.parametrize(
    ("status", "code"),
    [(2, "DEVICE_WATCHDOG"), (3, "DEVICE_TRAVEL"), (4, "DEVICE_SENSOR"), (0, "DEVICE_RESET"), (77, "DEVICE_RESET")],
)
@pytest.mark.parametrize("style", STYLES)
def test_the_devices_status_is_a_fault_by_name(style: str, status: int, code: str) -> None:
    rig = Rig(experiment_with(style))
    for _ in range(3):
        rig.tick(0.3)

    def saying(data: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, signed(data[:9] + status.to_bytes(2, "big")))]

    rig.block.disturb(OneReply(saying))
    fault = rig.fault_while_driving(1)
    assert fault.code == code
    assert f"status, holding register 19 reads {status}" in fault.detail
    assert rig.driver.safe_stop()


@pytest.mark.parametrize(("status", "code"), [(3, "DEVICE_TRAVEL"), (77, "DEVICE_RESET"), (1, "SECOND_MASTER")])
@pytest.mark.parametrize("seen_by", ["read", "arm"])
@pytest.mark.parametrize("style", STYLES)
def test_whatever_a_device_says_in_a_pause_but_off_is_told(style: str, seen_by: str, status: int, code: str) -> None:
    """Disarmed by the host the status is 0, which is none; what the block stops for by itself is, and what it means."""
    rig = Rig(experiment_with(style))
    rig.tick(0.3)
    assert rig.driver.safe_stop()
    rig.driver.read()

    def saying(data: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, signed(data[:9] + status.to_bytes(2, "big")))]

    rig.block.disturb(OneReply(saying))
    with pytest.raises(Fault, match=code) as caught:
        rig.driver.read() if seen_by == "read" else rig.arm()
    assert f"status, holding register 19 reads {status}" in caught.value.detail


def test_a_device_that_nothing_disarms_is_armed_in_a_pause() -> None:
    rig = Rig(experiment_with(registers={"control": None}))
    rig.tick(0.3)
    assert rig.driver.safe_stop()
    assert rig.block.truth().armed
    rig.driver.read()
    rig.arm()


@pytest.mark.parametrize("status", [1, 77])
def test_a_device_that_takes_its_time_to_stop_is_waited_for(status: int) -> None:
    """Its status is of the cycle before, or one of its own on the way to off; then the pause is as any other."""
    rig = Rig(experiment_with())
    rig.tick(0.3)
    off_s = rig.block.now_s() + 0.05

    def not_yet(direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        if direction == "reply" and data[1] == 3 and len(data) == 13 and t_s < off_s:
            data = signed(data[:9] + status.to_bytes(2, "big"))
        return [(0.0, data)]

    rig.block.disturb(not_yet)
    assert rig.driver.safe_stop()
    assert rig.block.now_s() >= off_s
    rig.driver.read()
    off_s = math.inf
    with pytest.raises(Fault, match=r"SECOND_MASTER|DEVICE_RESET"):
        rig.driver.read()
    assert rig.driver.safe_stop() == (status != 1)


@pytest.mark.parametrize("registers", [["watchdog"], ["limits", "rails"], ["max_drive"]], ids="-".join)
@pytest.mark.parametrize("style", STYLES)
def test_a_power_cycle_in_a_pause_is_found_when_it_is_armed_again(style: str, registers: list[str]) -> None:
    """By each of its settings alone; they are never written anew."""
    others = {name: None for name in ("watchdog", "limits", "rails", "max_drive") if name not in registers}
    own = {} if "watchdog" in registers else {"device_watchdog_s": 0.1}
    rig = Rig(experiment_with(style, others, **own))
    rig.tick(0.3)
    assert rig.driver.safe_stop()
    rig.block.power_cycle()
    rig.driver.read()  # its status is off, as before
    for _ in range(2):
        with pytest.raises(Fault, match="DEVICE_RESET") as caught:
            rig.arm()
        assert re.search(rf"^{registers[0]}\S*, holding register \d+ reads 0, but \d+ was written", caught.value.detail)
    assert not rig.block.truth().armed


@pytest.mark.parametrize("by_s", [0.095, 0.105, 0.15, 0.19])
@pytest.mark.parametrize("style", STYLES)
def test_a_late_reply_is_never_taken_for_that_of_the_next_register(style: str, by_s: float) -> None:
    """RTU numbers no replies: each would be taken for the next one's, and the device for a reset one."""
    rig = Rig(experiment_with(style))
    rig.tick(0.3)
    assert rig.driver.safe_stop()
    rig.block.disturb(lambda direction, data, t_s: ((by_s if direction == "reply" else 0.0, data),))
    fault: Fault | None = None
    try:
        rig.arm()
    except Fault as raised:
        fault = raised
    assert fault is None or fault.code == "LINK_TIMEOUT"
    assert (fault is None) == (by_s < 0.1)


def test_armed_again_only_other_limits_are_written() -> None:
    rig = Rig(experiment_with())
    real = rig.block.block._write
    written: list[str] = []

    def watching(values: dict[str, float]) -> None:
        written.extend(values)
        real(values)

    rig.block.block._write = watching  # type: ignore[method-assign]  # of this block alone
    assert rig.driver.safe_stop()
    rig.arm()
    assert set(written) == {"control", "drive", "sequence"}
    assert rig.driver.safe_stop()
    limits = rig.experiment.device.arming
    rig.driver.arm(replace(limits, max_u_V=0.5 * limits.max_u_V))
    assert "max_drive" in written
    assert rig.driver.safe_stop()
    rig.arm()
    rig.block.power_cycle()
    assert rig.fault_while_driving().code == "DEVICE_RESET"


def test_the_blocks_own_faults_come_through(rig: Rig) -> None:
    for _ in range(3):
        rig.tick(0.3)
    rig.block.place(2.2)
    fault = rig.fault_while_driving()
    assert fault.code in ("DEVICE_TRAVEL", "DEVICE_SENSOR")
    assert rig.driver.safe_stop()
    rig.block.place(0.0)
    rig.arm()
    for _ in range(3):
        rig.tick(0.3)
    rig.block.sleep_until(rig.block.now_s() + 2.0 * rig.experiment.daq.watchdog_s)
    rig._due_s = rig.block.now_s()
    assert rig.fault_while_driving().code == "DEVICE_WATCHDOG"


def test_noise_between_two_exchanges_is_thrown_away_and_counted(rig: Rig) -> None:
    for _ in range(3):
        rig.tick(0.3)
    rig.block.disturb(
        OneReply(lambda d: [(0.0, d), (0.014 if rig.driver.order == "sample_first" else 0.003, b"\xff\x00")])
    )
    rig.tick(0.3)
    rig.tick(0.3)
    assert rig.driver.link_statistics["stale_bytes"] == 2
    assert rig.driver.safe_stop()


def test_a_line_that_is_never_quiet_is_a_fault_and_ends() -> None:
    rig = Rig(experiment_with())
    rig.tick(0.3)
    rig.block.read = lambda timeout_s: b"\x55" * 16  # type: ignore[method-assign]  # of this block alone
    assert rig.fault_while_driving().code == "LINK_REPLY"
    assert not rig.driver.safe_stop()


# ---------------------------------------------------------------------- 20 corruptions a second


class RandomDamage:
    """Bytes changed, lost and come from nowhere at random instants, both ways; what nothing was sent for is made up."""

    def __init__(self, rate_1_s: float, seed: int) -> None:
        self._random = random.Random(seed)
        self._rate_1_s = rate_1_s
        self._next_s = 0.0
        self._corrupt = Corruption(1.0, seed)
        self.done = 0

    def begin(self, t_s: float) -> None:
        self._next_s = t_s + self._random.expovariate(self._rate_1_s)

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        while self._next_s <= t_s:
            self._next_s += self._random.expovariate(self._rate_1_s)
            self.done += 1
            ((_, data),) = self._corrupt(direction, data or b"\0", math.inf)
        return ((0.0, data),)


@pytest.mark.parametrize("style", [STYLES[0], *evidence(STYLES[1])])
def test_a_minute_of_damaged_bytes_never_moves_the_drive_to_a_value_that_nobody_commanded(style: str) -> None:
    """20 bytes a second, requests and replies; every fault is answered by a stop, and the run starts again."""
    rig = Rig(experiment_with(style))
    damaging = RandomDamage(20.0, seed=5)
    faults: dict[str, int] = {}
    ticks = 0
    clean_s = rig.block.now_s()
    while rig.block.now_s() - clean_s < 60.0:
        damaging.begin(rig.block.now_s())
        rig.block.disturb(damaging)
        try:
            while True:
                # a drive of its own for each tick: any other value at the output was commanded by nobody
                rig.tick(0.5 + 0.0012 * (ticks % 2000))
                ticks += 1
                if ticks % 10 == 0:
                    rig.block.place(0.0)  # it would run into its limits
        except Fault as fault:
            faults[fault.code] = faults.get(fault.code, 0) + 1
        rig.driver.safe_stop()
        rig.block.disturb(None)
        from_s = rig.block.now_s()
        rig.block.place(0.0)
        rig.arm()
        clean_s += rig.block.now_s() - from_s
    assert damaging.done > 1000
    assert sum(faults.values()) > 150  # each waits for a reply as long as the watchdog lets it
    assert set(faults) <= {"LINK_TIMEOUT", "LINK_REPLY", "LINK_UNIT", "MODBUS_EXCEPTION"}
    assert rig.block.requests["damaged"] > 100  # so many never reached a register
    assert rig.driven <= rig.commanded
    assert len(rig.driven) > 250


@pytest.mark.parametrize("watchdog", [True, False])
@pytest.mark.parametrize("style", STYLES)
def test_a_loop_reacts_within_the_time_that_the_room_to_stop_counts(style: str, watchdog: bool) -> None:
    """Whatever is late, and however often."""
    experiment = experiment_with(style, None if watchdog else {"watchdog": None})
    if not watchdog:
        experiment = experiment.model_copy(
            update={
                "daq": experiment.daq.model_copy(update={"accept_no_watchdog": True, "timeout_s": experiment.period_s})
            }
        )
    rig, d = Rig(experiment), experiment.device
    driver, timeout_s, longest_s = rig.driver, experiment.daq.timeout_s, 0.0

    def awaited_s() -> float:
        return min(
            driver._waits.left_s(rig.block.now_s()),
            max(driver._driven_s + driver._acts_s - rig.block.now_s(), timeout_s),
        )

    for seed in range(60):
        rig.arm()
        late = LateBus(awaited_s, 0.009, timeout_s, seed)
        rig.block.disturb(late)
        reaction_s = longest_reaction_s(driver, rig.block, late, d.period_s, reaction_periods(d))
        longest_s = max(longest_s, reaction_s)
        rig.block.disturb(None)
        rig.block.sleep_until(rig.block.now_s() + 1.0)
        driver.safe_stop()
    counted_s = stopping_rad(d) / d.limits.max_speed_rad_s - d.limits.coast_tau_s
    assert counted_s - 2.0 * d.period_s <= longest_s <= counted_s
