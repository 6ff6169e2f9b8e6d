"""The bus between a host and its servos: who answers when, what is damaged, who else speaks."""

from __future__ import annotations

from typing import Any

import further_requests
import pytest
from servo_bench import addressed
from servo_host import DynamixelHost, FeetechHost, Host

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Corruption
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.bus import LineTimes, ServoBus
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.packets import Skipped
from rig.backends.servo.registers import servo_map
from rig.core.faults import Fault

AT_ONCE = {"return_delay_time": 0}
HOSTS = [DynamixelHost, FeetechHost]


def _others(host: type[Host], *ids: int) -> list[ServoOptions]:
    return [ServoOptions(model=host.default, id=id, registers=AT_ONCE) for id in ids]


def telemetry(host: Host) -> Any:
    """The read of a tick."""
    read = servo_map(host.model).read
    return host.codec.read(1, read.address, read.words)


def _ids(answers: list[Any]) -> list[int]:
    return [frame.id for frame in answers]


@pytest.mark.parametrize("kind", HOSTS)
def test_an_exchange_takes_its_bytes(kind: type[Host]) -> None:
    """And the return delay, and the adapter; the design's table has the same times."""
    for baud, delay, adapter_s in ((1_000_000, 0, 0.0), (115_200, 100, 0.001)):
        line = LineTimes(baud=baud, adapter_s=adapter_s)
        host = kind(bus={"line": line}, baud=baud, registers={"return_delay_time": delay})
        asked = telemetry(host)
        begins_s = host.bus.now_s()
        host.bus.write(asked)
        answer = host.bus.read(1.0)
        assert len(answer) == host.codec.reply_bytes(servo_map(host.model).read.words)
        wire_s = 10 * (len(asked) + len(answer)) / baud
        assert host.bus.now_s() - begins_s == pytest.approx(wire_s + 2e-6 * delay + adapter_s, abs=1e-9)


@pytest.mark.parametrize("kind", HOSTS)
def test_a_duty_and_a_read_go_out_together(kind: type[Host]) -> None:
    host = kind(registers=AT_ONCE)
    drive = host.model.role("drive")
    both = further_requests.sync_write(host.codec, drive.address, {1: drive.pack(0)}) + telemetry(host)
    assert len(host.ask(both)) == 1
    assert [type(heard.frame).__name__ for heard in host.bus.bus.log] == ["Frame", "Frame"]
    first, second = (heard.t_s for heard in host.bus.bus.log)
    assert second - first == pytest.approx(10 * len(telemetry(host)) / 1e6)
    assert host.bus.bus.collisions == 0


def test_group_reads_are_answered_in_their_order() -> None:
    host = DynamixelHost(*_others(DynamixelHost, 2, 3), registers=AT_ONCE)
    assert _ids(host.ask(dynamixel.ping())) == [1, 2, 3]
    assert _ids(host.ask(further_requests.sync_read(dynamixel, 132, 4, [3, 1, 2]))) == [3, 1, 2]
    assert _ids(host.ask(further_requests.bulk_read({2: (132, 4), 1: (146, 1)}))) == [2, 1]
    (frame,) = host.ask(further_requests.fast_sync_read(132, 4, [3, 1]))
    assert _ids(further_requests.fast_statuses(frame, {3: 4, 1: 4})) == [3, 1]
    (frame,) = host.ask(further_requests.fast_bulk_read({2: (7, 1), 3: (7, 1)}))
    assert [s.data for s in further_requests.fast_statuses(frame, {2: 1, 3: 1})] == [b"\x02", b"\x03"]


def test_behind_one_that_is_absent_none_answers() -> None:
    host = DynamixelHost(*_others(DynamixelHost, 2), registers=AT_ONCE)
    assert _ids(host.ask(further_requests.sync_read(dynamixel, 132, 4, [1, 9, 2]))) == [1]
    cut = host.ask(further_requests.fast_sync_read(132, 4, [1, 9, 2]))
    assert cut and all(isinstance(taken, Skipped) for taken in cut)
    assert host.ask(further_requests.fast_sync_read(132, 4, [9, 1])) == []
    asks_253 = dynamixel.Frame(dynamixel.BROADCAST, 0x8A, b"\x84\x00\x04\x00\x01\xfd").encode()
    assert all(isinstance(taken, Skipped) for taken in host.ask(asks_253))
    other = FeetechHost(*_others(FeetechHost, 2))
    assert _ids(other.ask(further_requests.sync_read(feetech, 56, 2, [2, 1]))) == [2, 1]
    assert _ids(other.ask(further_requests.sync_read(feetech, 56, 2, [1, 9, 2]))) == [1]


@pytest.mark.parametrize("kind", HOSTS)
def test_group_writes_reach_whom_they_name(kind: type[Host]) -> None:
    host = kind(*_others(kind, 2, 3), registers=AT_ONCE)
    name = "led" if kind is DynamixelHost else "acceleration"
    address = host.model[name].address
    host.ask(further_requests.sync_write(host.codec, address, {1: b"\x01", 3: b"\x01"}))
    assert [host.bus.bus.servo(id).value(name) for id in (1, 2, 3)] == [1, 0, 1]
    assert addressed(host.bus.bus) == {1: 1, 3: 1}
    host.ask(host.codec.write(host.codec.BROADCAST, address, b"\x00"))
    assert [host.bus.bus.servo(id).value(name) for id in (1, 2, 3)] == [0, 0, 0]
    assert addressed(host.bus.bus) == {1: 1, 3: 1, host.codec.BROADCAST: 1}


def test_a_bulk_write_has_addresses_of_its_own() -> None:
    host = DynamixelHost(*_others(DynamixelHost, 2), registers=AT_ONCE)
    host.ask(further_requests.bulk_write({1: (65, b"\x01"), 2: (112, b"\x07\x00\x00\x00")}))
    assert host.read("led") == 1 and host.read("profile_velocity", id=2) == 7


@pytest.mark.parametrize("kind", HOSTS)
def test_an_echo_is_what_was_sent(kind: type[Host]) -> None:
    host = kind(bus={"line": LineTimes(echo=True)}, registers=AT_ONCE)
    asked = host.codec.ping(1)
    host.bus.write(asked)
    assert host.bus.read(1.0) == asked
    assert host.codec.status_of(*host.codec.Stream().feed(host.bus.read(1.0))).id == 1
    host.bus.write(host.codec.ping(9))
    assert host.bus.read(1.0) == host.codec.ping(9) and host.bus.read(0.01) == b""


@pytest.mark.parametrize("kind", HOSTS)
def test_another_baud_is_not_heard(kind: type[Host]) -> None:
    host = kind(*[ServoOptions(model=kind.default, id=2, baud=115_200)], registers=AT_ONCE)
    assert host.ask(host.codec.ping(2)) == []
    host.bus.set_baud(115_200)
    assert _ids(host.ask(host.codec.ping(2))) == [2] and host.ask(host.codec.ping(1)) == []


@pytest.mark.parametrize("kind", HOSTS)
def test_who_speaks_meanwhile_damages_both(kind: type[Host]) -> None:
    host = kind(registers={"return_delay_time": 100})
    host.bus.write(telemetry(host))
    host.sleep(0.0004)
    taken = host.ask(host.codec.ping(1))
    assert all(isinstance(t, Skipped) for t in taken) and host.bus.bus.collisions == 1
    assert len(host.bus.bus.log) == 1
    assert _ids(host.ask(host.codec.ping(1))) == [1]
    eager = kind(registers=AT_ONCE)
    assert all(isinstance(t, Skipped) for t in eager.ask(eager.codec.ping(1) + eager.codec.write(1, 65, b"\x01\x01")))
    assert eager.bus.bus.collisions > 0


@pytest.mark.parametrize("kind", HOSTS)
def test_another_master_is_heard_by_all(kind: type[Host]) -> None:
    host = kind(registers=AT_ONCE)
    host.bus.bus.another_master(telemetry(host), 0.01)
    assert host.bus.read(1.0) == telemetry(host)
    assert len(host.bus.read(1.0)) == host.codec.reply_bytes(servo_map(host.model).read.words)


@pytest.mark.parametrize("kind", HOSTS)
def test_faults_of_the_answers(kind: type[Host]) -> None:
    host = kind(registers=AT_ONCE)
    host.ready()  # type: ignore[attr-defined]
    torque = host.model.role("torque")
    asked = host.codec.read(1, torque.address, 1)

    def under(fault: ReplyFault) -> list[Any]:
        host.bus.bus.reply_fault = fault
        return host.ask(asked)

    name = "acceleration" if kind is FeetechHost else "led"

    def written(fault: ReplyFault, value: int) -> int:
        host.bus.bus.reply_fault = fault
        host.ask(host.codec.write(1, host.model[name].address, bytes((value,))))
        return host.bus.bus.servo(1).value(name)

    assert under(ReplyFault("lost", times=1)) == [] and len(host.ask(asked)) == 1
    assert under(ReplyFault("lost", servo=2))[0].id == 1
    assert under(ReplyFault("lost", after_s=1e6))[0].id == 1
    assert under(ReplyFault("id", id=42))[0].id == 42
    assert host.codec.status_of(under(ReplyFault("short"))[0]).data == b""
    alert = host.codec.status_of(under(ReplyFault("alert"))[0])
    assert alert.alert if kind is DynamixelHost else alert.words
    assert under(ReplyFault("late", by_s=0.02)) == []
    host.sleep(0.05)
    assert len(host.bus.read(0.0)) == host.codec.reply_bytes(1)
    assert written(ReplyFault("lost"), 1) == 1 and written(ReplyFault("deaf"), 0) == 1
    host.bus.bus.reply_fault = None
    assert len(host.ask(asked)) == 1


@pytest.mark.parametrize("kind", HOSTS)
def test_a_damaged_line_never_does_what_was_not_said(kind: type[Host]) -> None:
    """One byte of a packet is changed, lost or added, sixty times in a second."""
    host = kind(registers=AT_ONCE, bus={"disturbance": Corruption(60.0, 3)})
    name = "led" if kind is DynamixelHost else "acceleration"
    lost = 0
    for n in range(200):
        answers = host.ask(host.codec.write(1, host.model[name].address, bytes((n % 2,))))
        lost += not [a for a in answers if not isinstance(a, Skipped)]
        assert host.bus.bus.servo(1).value(name) in (0, 1)
    assert 20 < lost < 150 and host.bus.bus.damaged > 10


def test_a_packet_that_was_not_finished_is_forgotten() -> None:
    host = DynamixelHost(registers=AT_ONCE)
    host.bus.write(dynamixel.ping(1)[:-1])
    host.sleep(0.5)
    assert _ids(host.ask(dynamixel.ping(1))) == [1]
    assert host.bus.bus.damaged == 1
    host.bus.write(dynamixel.ping(1)[:4])
    host.sleep(0.002)
    host.bus.write(dynamixel.ping(1)[4:])
    assert len(host.bus.read(0.1)) == 14, "in two parts it is one packet"


def test_an_unplugged_bus() -> None:
    bus = VirtualServoBus([ServoOptions()])
    bus.unplug()
    for call in (lambda: bus.read(0.0), lambda: bus.write(b"")):
        with pytest.raises(Fault) as caught:
            call()
        assert caught.value.code == "LINK_LOST"


@pytest.mark.parametrize(
    "servos",
    [[], [ServoOptions(), ServoOptions(model="sts3215", id=2)], [ServoOptions(), ServoOptions()]],
    ids=["none", "two protocols", "one id twice"],
)
def test_a_bus_that_cannot_be(servos: list[ServoOptions]) -> None:
    with pytest.raises(EmulationError, match=r"protocol|its own"):
        ServoBus(servos)


def test_bystanders_neither_move_nor_change() -> None:
    host = DynamixelHost(*_others(DynamixelHost, 2, 3), registers=AT_ONCE)
    seen = [host.bus.bus.servo(id).peek(0, 119) for id in (2, 3)]
    host.ready(500)
    host.sleep(1.0)
    assert [host.bus.bus.servo(id).peek(0, 119) for id in (2, 3)] == seen
    assert addressed(host.bus.bus).keys() == {1}
    assert [host.bus.truth(id).y_rad for id in (2, 3)] == [0.0, 0.0]
    with pytest.raises(KeyError):
        host.bus.bus.servo(4)
