"""What a hostile look at the servo driver found, once each: none of it may come back."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from evidence import evidence
from servo_bench import BYSTANDERS, PROTOCOLS, Bench, Keeper

from rig.backends.driver import Timeouts
from rig.backends.links.usb_port import usb_port
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo import facts as tried
from rig.backends.servo import keeper as keepers
from rig.backends.servo.before import BeforeStore, store_of
from rig.backends.servo.bus import ServoLink
from rig.backends.servo.driver import ServoDriver
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.facts import facts
from rig.backends.servo.guardian import Guardian
from rig.backends.servo.scan import reboot, restore, set_baud
from rig.core.faults import Fault
from rig.core.link_turn import turn_on


def use_limit_of_config(bench: Bench) -> None:
    """The limit of a Feetech's owner is that of the run: after a restart nothing but the mode tells of it."""
    if bench.setup.model.protocol != "feetech":
        return
    bench.servo.put("max_torque", bench.setup.max_units)
    bench.servo._keep(bench.servo.model["max_torque"])


@pytest.mark.parametrize("in_pause", [False, True])
def test_a_servo_that_restarted_before_it_is_armed_never_gets_its_torque_in_another_mode(in_pause: bool) -> None:
    """With the lock at 1 a Feetech forgets the mode: in its own it would go to a goal of its own under full drive."""
    bench = Bench("feetech")
    use_limit_of_config(bench)
    bench.opened()
    if in_pause:
        bench.driver.arm(bench.limits)
        bench.tick(0.3)
        assert bench.driver.safe_stop()
    bench.servo.power_cycle()
    bench.bus.sleep_until(bench.bus.now_s() + 0.3)
    with pytest.raises(Fault, match="DEVICE_RESET"):
        bench.driver.arm(bench.limits)
    assert not bench.servo.is_on and bench.wrong() == []


def restarting_ahead_of(bench: Bench, ahead: Callable[[bytes], bool]) -> list[bytes]:
    """From now on the servo loses its supply for an instant ahead of the first packet of that kind."""
    real, restarted = bench.bus.write, list[bytes]()

    def write(data: bytes) -> None:
        if not restarted and ahead(data):
            restarted.append(data)
            bench.bus.power_cycle()
        real(data)

    bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
    return restarted


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("what", ["the torque", "the look at the goal", "the duty"])
def test_a_servo_that_restarts_while_it_is_armed_never_gets_its_torque(protocol: str, what: str) -> None:
    """A request that it did not hear while it started was repeated: full drive, or a way to a goal of its own.

    A Dynamixel has forgotten its watchdog, too.
    """
    bench = Bench(protocol, goal_at_boot=0, torque_on_by_goal=True)
    use_limit_of_config(bench)
    bench.opened()
    bus, model = bench.driver._bus, bench.setup.model
    torque, drive = model.role("torque"), model.role("drive")
    asks = {
        "the torque": bus.writing(torque.address, b"\x01", ""),
        "the look at the goal": bus.reading(drive.address, drive.size, ""),
        "the duty": bus.writing(drive.address, drive.pack(0), ""),
    }
    stood_rad = bench.servo.truth().y_rad
    restarted = restarting_ahead_of(bench, asks[what].data.__eq__)
    with pytest.raises(Fault, match=r"DEVICE_RESET|ARM_READBACK"):
        bench.driver.arm(bench.limits)
    assert restarted and bench.wrong() == [] and bench.servo.truth().y_rad == stood_rad and not bench.servo.is_on
    assert bench.driver.safe_stop() and not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_mode_that_another_master_changes_right_before_the_torque_takes_it_off_again(protocol: str) -> None:
    """As the keeper of a rig on a second adapter of this bus: the servo would go to a goal of its own."""
    bench = Bench(protocol)
    bench.opened()
    model, send = bench.servo.model, bench.bus.bus.send
    torque = bench.driver._link.write_of(model.roles["torque"], 1).data

    def ahead(data: bytes, t_s: float) -> None:
        if data == torque:
            bench.servo.put(model.roles["mode"], model.position_mode)
        send(data, t_s)

    bench.bus.bus.send = ahead  # type: ignore[method-assign]
    with pytest.raises(Fault, match="DEVICE_RESET"):
        bench.driver.arm(bench.limits)
    assert not bench.servo.is_on


@pytest.mark.parametrize("in_pause", [False, True])
def test_a_write_of_a_duty_never_switches_a_servo_on_that_has_lost_its_mode(in_pause: bool) -> None:
    """On some servos the write of a goal does: in its own mode it would go to a goal of its own."""
    bench = Bench("feetech", torque_on_by_goal=True)
    use_limit_of_config(bench)
    bench.armed()
    bench.tick(0.3)
    if in_pause:
        assert bench.driver.safe_stop()
    bench.bus.power_cycle()
    bench.bus.sleep_until(bench.bus.now_s() + 0.3 * in_pause)
    with pytest.raises(Fault, match=r"DEVICE_RESET|LINK_TIMEOUT"):
        bench.driver.arm(bench.limits) if in_pause else bench.driver.read()
    bench.driver._client.wait(0.3)
    assert bench.driver.safe_stop() and not bench.servo.is_on and bench.wrong() == []
    asks = [ask.data for ask in keepers.stop_orders(bench.driver._link)]
    for data in asks:
        bench.bus.write(data)
        bench.driver._client.wait(0.01)
    assert not bench.servo.is_on and bench.wrong() == []


@pytest.mark.parametrize("u_V", [0.0, 0.3])
def test_a_servo_that_restarts_within_one_period_gets_no_duty_any_more(
    u_V: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At duty 0 a reading of the duty tells nothing of it, and at another one the first reading is not believed."""
    monkeypatch.setattr("rig.backends.servo.emulated.servo._BOOT_S", 0.004)
    bench = Bench("feetech", torque_on_by_goal=True)
    use_limit_of_config(bench)
    bench.armed()
    bench.tick(u_V)
    bench.bus.power_cycle()
    bench.bus.sleep_until(bench.bus.now_s() + 0.006)
    fault = bench.fault_within(2, 0.3)
    assert fault is not None and fault.code == "DEVICE_RESET" and bench.wrong() == []
    assert bench.driver.safe_stop() and not bench.servo.is_on


@pytest.mark.parametrize(("protocol", "first"), [
    *((p, 60) for p in PROTOCOLS), *evidence(*((p, f) for p in PROTOCOLS for f in range(1, 180, 20))),
])  # fmt: skip
def test_a_supply_that_fails_ahead_of_any_packet_of_a_run_never_drives(protocol: str, first: int) -> None:
    for number in range(first, first + 20) if first != 60 else (62,):
        bench, left = Bench(protocol, torque_on_by_goal=True), number
        use_limit_of_config(bench)

        def ahead(data: bytes, protocol: str = protocol, number: int = number) -> bool:
            nonlocal left
            left -= left < number or data[7 if protocol == "dynamixel" else 4] == 3  # from the first write on
            return left < 0

        restarting_ahead_of(bench, ahead)
        with suppress(Fault):
            bench.armed()
            for k in range(4):
                bench.tick(0.4 if k < 2 else -0.4)
            bench.driver.safe_stop()
            bench.driver.arm(bench.limits)
            bench.tick(0.2)
        bench.driver.safe_stop()
        bench.driver.close()
        assert max(abs(volts) for _, volts in bench.bus.outputs[0]) <= 0.41, number
        assert bench.wrong() == [] and not bench.servo.is_on, number


def test_a_servo_that_duty_0_does_not_stop_loses_its_torque_at_once() -> None:
    bench = Bench("feetech")
    bench.armed()
    bench.tick(0.3)
    bench.servo.put("mode", 0)  # somebody else's
    bench.servo.put("goal_position", 0)
    fault = bench.fault_within(20)
    assert fault is not None and fault.code == "DEVICE_RESET" and "mode" in fault.detail
    assert bench.driver.safe_stop() and not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("lost", [2, 5, 9, 11])
def test_one_lost_request_of_a_stop_leaves_no_torque_on(protocol: str, lost: int) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    sent, left = bench.bus.write, lost

    def write(data: bytes) -> None:
        nonlocal left
        left -= 1
        if left != -1:
            sent(data)

    bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
    assert bench.driver.safe_stop()
    assert left < 0 and not bench.servo.is_on


@pytest.mark.parametrize(("protocol", "bit"), [("dynamixel", 0x20), ("feetech", feetech.CURRENT)])
def test_a_torque_that_is_refused_for_an_error_is_told_by_its_name(protocol: str, bit: int) -> None:
    bench = Bench(protocol)
    bench.opened()
    bench.servo.fail(bit)  # type: ignore[attr-defined]  # both protocols have it
    with pytest.raises(Fault, match="SERVO_OVERLOAD"):
        bench.driver.arm(bench.limits)
    bench.driver.close()
    assert not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("what", [
    lambda bench, link: restore(link, bench.store),
    lambda bench, link: reboot(link),  # its torque would go: an arm that it holds falls
    lambda bench, link: set_baud(lambda baud: nullcontext(bench.bus), link, 500_000, bench.store),
], ids=["restore", "reboot", "baud"])  # fmt: skip
def test_nothing_is_put_back_while_another_master_talks(
    what: Callable[[Bench, ServoLink], object], protocol: str, tmp_path: Path
) -> None:
    """Nor is that servo rebooted, nor given another baud."""
    bench = Bench(protocol, store=BeforeStore(tmp_path / "servo.json"))
    bench.opened()
    link, codec = bench.driver._link, dynamixel if protocol == "dynamixel" else feetech
    written = len(bench.bus.bus.log)
    for k in range(6):
        bench.bus.bus.another_master(codec.ping(BYSTANDERS[0]), bench.bus.now_s() + 0.0053 + 0.01 * k)
    with pytest.raises(Fault, match="SECOND_MASTER"):
        what(bench, link)
    own = [frame for who, frame in bench.bus.bus.log[written:] if frame.id == bench.own.id]
    assert own == [] and bench.store.load(link.model)


class Watching:
    """A keeper that only notes what had been written when it was called, and whether it was let go."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.written_before: int | None = None
        self.ended: bool | None = None
        self.has_acted = False
        self.turned_unheard_s = 0.0  # longest time that the servo was given a duty that turns it, and nobody heard rig
        self._heard_s: float | None = None

    def __call__(self, link: ServoLink, store: BeforeStore) -> Watching:
        codes = [f.instruction if isinstance(f, dynamixel.Frame) else f.code for _, f in self.bench.bus.bus.log]
        self.written_before = sum(code == feetech.Instruction.WRITE for code in codes)  # the same of both
        assert store.load(link.model)
        return self

    @property
    def hears(self) -> bool:
        """Whether it would act if rig fell silent now."""
        return self._heard_s is not None

    def beat(self) -> None:
        self.rest()
        self._heard_s = self.bench.bus.now_s()

    def waits(self) -> None:
        if self._heard_s is not None:
            self.beat()

    @property
    def silent_s(self) -> float:
        """For how long it has not heard of rig, s."""
        return 0.0 if self._heard_s is None else self.bench.bus.now_s() - self._heard_s

    def rest(self) -> None:
        if self._heard_s is not None:
            self.turned_unheard_s = max(self.turned_unheard_s, self.bench.bus.now_s() - self._heard_s)
        self._heard_s = None

    def end(self, *, restored: bool) -> None:
        self.ended = restored


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_keeper_watches_before_anything_is_written(protocol: str) -> None:
    """While the watchdog is tried the torque is on: who kills rig there would leave it on."""
    bench = Bench(protocol)
    watching = Watching(bench)
    bench.driver._start_guardian = watching
    bench.opened()
    assert watching.written_before == 0
    bench.driver.close()
    assert watching.ended is True


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_keeper_watches_while_facts_are_tried(protocol: str) -> None:
    bench = Bench(protocol)
    watching = Watching(bench)
    if protocol == "feetech":  # people say that theirs begin to drive at 50 steps
        target = bench.servo._target
        bench.servo._target = lambda: 0.0 if abs(target()) < 50.0 else target()  # type: ignore[method-assign]
    link, heard = bench.driver._link, []
    put, drive = link.put, link.model.roles["drive"]

    def noted(name: str, value: int) -> None:
        if name == drive and abs(value) > 10 and bench.servo.of("mode") == link.model.pwm_mode:  # it may turn
            heard.append(watching.hears)
        put(name, value)

    link.put = noted  # type: ignore[method-assign]  # of this one
    told = {fact.name for fact in facts(link, bench.store, lambda: None, watching)}
    assert ("protects_in_pwm" in told) == (protocol == "feetech")
    assert watching.written_before == 0 and watching.ended is True
    assert all(heard) and 0.0 < watching.turned_unheard_s < 0.06  # it hears rig while the horn turns: Ctrl-Z stops it


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_facts_end_where_the_keeper_had_to_act(protocol: str) -> None:
    bench = Bench(protocol)
    watching = Watching(bench)
    watching.has_acted = True
    with pytest.raises(Fault, match="DEVICE_WATCHDOG"):
        list(facts(bench.driver._link, bench.store, None, watching))
    assert watching.ended is True and not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_drive_follows_the_stop_of_the_keeper(protocol: str) -> None:
    """Rig looks last, when all but the write is done: it may have stood still anywhere ahead of that."""
    bench = Bench(protocol)
    watching = Watching(bench)
    bench.driver._start_guardian = watching
    bench.armed()
    bench.tick(1.0)
    driven = bench.servo.of("drive")

    def stands_still() -> None:
        watching.has_acted = True

    watching.beat = stands_still  # type: ignore[method-assign]  # of this one
    with pytest.raises(Fault, match="DEVICE_WATCHDOG"):
        bench.driver.write(-1.0)
    assert bench.servo.of("drive") == driven != 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("late", [False, True])
def test_who_goes_on_after_the_keeper_has_acted_says_so(protocol: str, late: bool) -> None:
    """The first reading shows its stop; or the bus is only late."""
    bench = Bench(protocol)
    watching = Watching(bench)
    bench.driver._start_guardian = watching
    bench.armed()
    bench.tick(1.0)
    bench.bus.sleep_until(bench.bus.now_s() + 0.02)
    watching.has_acted = True
    if late:
        bench.driver._waits.restart(0.01, bench.bus.now_s())
        bench.bus.bus.reply_fault = ReplyFault("late", by_s=0.02)
    else:
        bench.servo._set("torque", 0)
        bench.bus.sleep_until(bench.bus.now_s() + 0.002)
    with pytest.raises(Fault, match=r"DEVICE_WATCHDOG.*keeper"):
        bench.driver.read()
    bench.bus.bus.reply_fault = None
    assert bench.driver.safe_stop() and "keeper" in bench.driver.end_words


def test_a_servo_that_does_not_answer_is_no_silence_of_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    """The keeper would act while rig waits, and rig would end with that, not with the cable that is out."""
    bench = Bench()
    watching = Watching(bench)
    bench.driver._start_guardian = watching
    bench.armed()
    bench.tick(1.0)
    watchdog_s = bench.limits.watchdog_s
    acts = property(lambda one: one.silent_s >= watchdog_s)
    monkeypatch.setattr(Watching, "has_acted", acts, raising=False)
    monkeypatch.setattr(bench.bus, "write", lambda data: None)
    with pytest.raises(Fault, match="LINK_TIMEOUT"):
        bench.driver.read()


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("acts", [True, False])
def test_a_stop_waits_until_that_of_the_keeper_is_over(
    protocol: str, acts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one bus the answers to both are the same."""
    bench = Bench(protocol)
    watching = Watching(bench)
    bench.driver._start_guardian = watching
    bench.armed()
    bench.tick(1.0)
    written, turns = len(bench.bus.bus.log), []

    @contextmanager
    def noted(link: int, wait_s: float) -> Iterator[bool]:
        turns.append(("has", len(bench.bus.bus.log) - written))
        yield True
        turns.append(("lets go", len(bench.bus.bus.log) - written))

    monkeypatch.setattr(bench.bus, "descriptor", 7, raising=False)
    monkeypatch.setattr("rig.backends.servo.driver.turn_on", noted)
    watching.has_acted = acts
    assert bench.driver.safe_stop()
    assert turns == ([("has", 0), ("lets go", 0)] if acts else [])


@pytest.mark.parametrize(("moves", "first", "words"), [
    (True, "sh -c rig run", "lives for `sh -c rig run`"), (True, "", "Too many"), (False, "sh -c rig run", "Too many"),
])  # fmt: skip
def test_nobody_drives_whose_keeper_ends_with_it(
    moves: bool, first: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where rig is what a container lives for (``rig.core.first_process``): nothing is written to a servo then."""

    def full() -> tuple[int, int]:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(keepers, "first_that_ends_with", lambda _: first)
    monkeypatch.setattr(keepers, "os", SimpleNamespace(getpid=os.getpid, pipe=full, close=os.close))
    bench = Bench()
    bench.driver._start_guardian = keepers.starter(0, 0.06, moves=moves)
    with pytest.raises(Fault, match="SERVO_UNWATCHED") as raised:
        bench.opened()
    assert words in raised.value.detail and not bench.servo.is_on and bench.servo.eeprom_writes.total() == 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_facts_switch_no_torque_on_after_the_stop_of_the_keeper(protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(protocol)
    watching = Watching(bench)
    bench.opened()

    def stands_still(link: ServoLink) -> None:
        watching.has_acted = True

    monkeypatch.setattr("rig.backends.servo.opening.other_mode", stands_still)
    with pytest.raises(Fault, match="DEVICE_WATCHDOG"):
        tried._still(bench.driver._link, 100, watching)
    assert not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_that_restarts_while_it_is_set_up_never_gets_its_torque(protocol: str) -> None:
    """A Feetech forgets the mode, a Dynamixel has its whole limit for a goal: its torque would move it at once."""
    bench = Bench(protocol)
    use_limit_of_config(bench)
    value, link = bench.driver._link.value, bench.driver._link

    def restarting(name: str) -> int:
        if name == link.model.roles["firmware"]:
            bench.bus.power_cycle()
            bench.bus.sleep_until(bench.bus.now_s() + 0.3)
        return value(name)

    link.value = restarting  # type: ignore[method-assign]  # of this one
    if protocol == "feetech":  # it has no watchdog to be tried: the torque goes on when it is armed
        bench.opened()
        link.value = value  # type: ignore[method-assign]
    with pytest.raises(Fault, match=r"ARM_READBACK|DEVICE_RESET"):
        bench.armed() if protocol == "dynamixel" else bench.driver.arm(bench.limits)
    assert not bench.servo.is_on and bench.wrong() == []


@pytest.mark.parametrize("restarts_at", [2, 5, 10])
def test_a_servo_that_restarts_while_facts_are_tried_never_gets_its_torque(
    restarts_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a horn's start takes the supply down: in its own mode it would go to a goal of its own."""
    bench, calls = Bench("feetech"), []
    real = tried._still

    def still(link: ServoLink, duty: int, *heard: Guardian | None) -> None:
        calls.append(duty)
        if len(calls) == restarts_at:
            bench.bus.power_cycle()
            bench.bus.sleep_until(bench.bus.now_s() + 0.3)
            bench.servo.put("goal_position", 100)
        real(link, duty, *heard)

    monkeypatch.setattr(tried, "_still", still)
    with pytest.raises(Fault, match="DEVICE_RESET"):
        list(facts(bench.driver._link, bench.store, lambda: None))
    assert not bench.servo.is_on and bench.wrong() == []


@pytest.mark.parametrize(("role", "value"), [("drive", 3), ("drive", 120), ("goal_position", None), ("torque", 0)])
def test_no_fact_switches_a_servo_on_that_has_lost_its_supply(role: str, value: int | None) -> None:
    """A goal may do so, and that of the duty is another one in the mode that it starts with."""
    bench = Bench("feetech", torque_on_by_goal=True, goal_at_boot=0)
    model = bench.setup.model
    register = model.role(role) if role in model.roles else model[role]
    begins = bench.driver._bus.writing(register.address, register.pack(value or 0), "").data
    begins = begins if value is not None else begins[: -1 - register.size]
    at_s: list[float] = []

    def ahead(data: bytes) -> bool:
        is_it = bench.servo.is_on and data.startswith(begins)
        at_s.extend([bench.bus.now_s()] if is_it else [])
        return is_it

    restarting_ahead_of(bench, ahead)
    with pytest.raises(Fault, match=r"DEVICE_RESET|ARM_READBACK"):
        list(facts(bench.driver._link, bench.store))
    goals = (model.role("drive").address, model["goal_position"].address)
    later = [f for t_s, f in bench.bus.bus.log if isinstance(f, feetech.Frame) and t_s > at_s[0] + 0.001]
    assert not [f for f in later if f.code == feetech.Instruction.WRITE and f.parameters[0] in goals]
    assert not bench.servo.is_on and bench.wrong() == []


def test_a_servo_that_drives_when_it_starts_is_not_rebooted() -> None:
    bench = Bench()
    bench.servo.put("startup_configuration", 1)
    bench.servo._keep(bench.servo.model["startup_configuration"])
    with pytest.raises(Fault, match="SERVO_SETUP"):
        reboot(bench.driver._link)
    assert not bench.servo.is_on


@pytest.mark.parametrize("what", [
    lambda bench, link: (bench.store.save(link.model, 1, {"pwm_limit": 300}), restore(link, bench.store)),
    lambda bench, link: reboot(link),
    lambda bench, link: set_baud(lambda baud: nullcontext(bench.bus), link, 57_600, bench.store),
], ids=["restore", "reboot", "baud"])  # fmt: skip
def test_no_command_is_obeyed_by_a_servo_that_has_the_id_as_its_second(
    what: Callable[[Bench, ServoLink], object], tmp_path: Path
) -> None:
    """What it holds would fall."""
    bench = Bench(others={"secondary_id": 1, "torque_enable": 1}, store=BeforeStore(tmp_path / "servo.json"))
    link = bench.driver._link
    with pytest.raises(Fault, match="SERVO_SETUP"):
        what(bench, link)
    assert all(servo.is_on and servo.value("baud_rate") == 3 for servo in bench.bystanders)


@pytest.mark.parametrize("opens", [True, False])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_that_somebody_has_taken_over_since_keeps_its_torque(
    protocol: str, opens: bool, tmp_path: Path
) -> None:
    """Rig died, the next program holds an arm up, and its bus is silent: to put back would let the arm fall."""
    bench = Bench(protocol, store=BeforeStore(tmp_path / "servo.json"))
    bench.opened()
    bench.servo.put(bench.setup.model.roles["mode"], 3 if protocol == "dynamixel" else 0)  # of positions
    bench.servo.put(bench.setup.model.roles["torque"], 1)
    link = bench.another()._link
    with pytest.raises(Fault, match="SERVO_IN_USE"):
        bench.driver.open() if opens else restore(link, bench.store)
    bench.driver.close()
    assert bench.servo.is_on and bench.store.load(link.model)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_that_was_in_pwm_mode_is_left_without_rigs_duty(protocol: str) -> None:
    """Also by its keeper, where the servo took no duty 0 since its watchdog had acted, or where none is written."""
    bench = Bench(protocol, goal_at_boot=0)
    bench.servo._set("mode", bench.setup.model.pwm_mode)
    bench.armed()
    bench.tick(0.3)
    keeper = Keeper(bench)(bench.driver._link, bench.store)
    keeper._zero = ()
    assert keeper.restore() and bench.servo.of("drive") == 0 and not bench.servo.is_on


def test_goals_that_a_mode_change_resets_are_put_back() -> None:
    """In the mode of a gripper its goal of current bounds what it may squeeze with."""
    bench = Bench("dynamixel")
    wanted = {"operating_mode": 5, "goal_current": 120, "goal_velocity": 33}
    for name, value in wanted.items():
        bench.servo.put(name, value)
    bench.armed()
    bench.tick(0.3)
    bench.driver.safe_stop()
    bench.driver.close()
    assert {name: bench.servo.value(name) for name in wanted} == wanted and bench.wrong() == []


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_file_of_before_that_is_deleted_meanwhile_is_not_needed(protocol: str, tmp_path: Path) -> None:
    bench = Bench(protocol, store=BeforeStore(tmp_path / "servo.json"))
    registers = bench.registers()
    bench.armed()
    (tmp_path / "servo.json").unlink()
    bench.driver.safe_stop()
    bench.driver.close()
    assert bench.registers() == registers


def test_a_feetech_with_an_error_of_its_supply_is_no_echo() -> None:
    """Its answer to a ping would be the ping's own bytes: the whole bus would be taken for one that echoes."""
    assert feetech.ping(4) == feetech.status(4, errors=feetech.VOLTAGE)
    bench = Bench("feetech")
    for servo in bench.bystanders:
        servo._failed |= feetech.VOLTAGE  # type: ignore[attr-defined]  # it is one of Feetech's
        servo._protect()  # type: ignore[attr-defined]
    bench.opened()
    assert not bench.driver._bus.echoes
    bench.driver.close()


@pytest.mark.parametrize(
    ("protocol", "name", "level"), [("dynamixel", "status_return_level", 1), ("feetech", "response_level", 0)]
)
def test_a_servo_that_does_not_answer_writes_is_refused_before_any(protocol: str, name: str, level: int) -> None:
    bench = Bench(protocol)
    bench.servo.put(name, level)
    with pytest.raises(Fault, match="does not answer") as raised:
        bench.opened()
    assert raised.value.code == "SERVO_SETUP" and bench.store.load(bench.setup.model) is None


def test_every_name_of_a_port_leads_to_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ttyUSB7").touch()
    (tmp_path / "usb-FTDI-if00").symlink_to(tmp_path / "ttyUSB7")
    own, other = (store_of(str(tmp_path / name), 1).path for name in ("ttyUSB7", "usb-FTDI-if00"))
    assert own == other
    port = usb_port("/dev/ttyUSB7")
    for tells in ({"serial_number": "FT1"}, {"location": "1-1.2"}):  # plugged in again it may have another name
        monkeypatch.setattr("rig.backends.servo.before.usb_port", lambda device, t=tells: port._replace(**t))
        assert store_of("/dev/ttyUSB0", 1).path == store_of("/dev/ttyUSB1", 1).path != own


def test_each_port_of_an_adapter_has_a_file_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is put back is of the servo at that port: another one of its model and id may be at the next."""
    port = usb_port("/dev/ttyUSB7")._replace(serial_number="FT4")
    monkeypatch.setattr(
        "rig.backends.servo.before.usb_port", lambda device: port._replace(location=f"1-1:1.{device[-1]}")
    )
    assert store_of("/dev/ttyUSB0", 1).path != store_of("/dev/ttyUSB1", 1).path


@pytest.mark.parametrize("error", [False, True])
def test_a_feetech_that_did_not_hear_of_its_reboot_is_not_told_to_have_done_it(error: bool) -> None:
    """It gives no answer to that: it answers the next question at once."""
    bench = Bench("feetech")
    bench.servo._set("torque", int(not error))
    bench.servo._failed = feetech.OVERLOAD if error else 0  # type: ignore[attr-defined]  # it is one of Feetech's
    reboots, send = feetech.reboot(bench.own.id), bench.bus.write
    bench.bus.write = lambda data: None if data == reboots else send(data)  # type: ignore[method-assign]
    with pytest.raises(Fault, match="SERVO_ERROR" if error else "SERVO_IN_USE"):
        reboot(bench.driver._link)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_that_reboots_answers_again(protocol: str) -> None:
    bench = Bench(protocol)
    reboot(bench.driver._link)
    assert not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_who_only_stops_writes_nothing_but_torque_off(protocol: str) -> None:
    """A law's keeper stops the servo beside the servo's own, which may have put the goals back just before."""
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.4)
    daq, before = bench.e.daq, len(bench.bus.bus.log)
    stopper = ServoDriver(
        bench.bus,
        bench.setup,
        daq.baud,
        bench.e.device.scaling,
        Timeouts(daq.timeout_s, 0.2),
        BeforeStore(),
        answered=True,
    )
    assert stopper.safe_stop() and not bench.servo.is_on
    torque = bench.setup.model.role("torque")
    wide = 2 if protocol == "dynamixel" else 1  # bytes of an address
    written = [
        frame.parameters
        for _, frame in bench.bus.bus.log[before:]
        if (frame.instruction if isinstance(frame, dynamixel.Frame) else frame.code) == feetech.Instruction.WRITE
    ]
    assert written and set(written) == {torque.address.to_bytes(wide, "little") + b"\0"}


def test_two_processes_that_stop_a_device_take_turns(tmp_path: Path) -> None:
    with (tmp_path / "port").open("w+b") as port:
        with turn_on(port.fileno(), 1.0) as mine:
            assert mine
            assert _told_by_another(port.fileno()) == b"n"
        assert _told_by_another(port.fileno()) == b"y"


def _told_by_another(port: int) -> bytes:
    """Whether another process that has the same open file gets its turn at once."""
    told, tells = os.pipe()
    pid = os.fork()
    if pid == 0:
        with turn_on(port, 0.0) as its:
            os.write(tells, b"y" if its else b"n")
        os._exit(0)
    os.waitpid(pid, 0)
    answer = os.read(told, 1)
    os.close(told)
    os.close(tells)
    return answer


@pytest.mark.parametrize("by_kill", [True, False])
def test_a_lock_that_stays_open_is_closed_by_the_next_command(by_kill: bool, tmp_path: Path) -> None:
    """Behind an open lock what a run writes would stay for good. A Fault closes it at once."""
    bench = Bench("feetech", store=BeforeStore(tmp_path / "servo.json"))
    link, baud = bench.driver._link, bench.driver._link.write_of("baud_rate", 1).data
    send = bench.bus.write

    def write(data: bytes) -> None:
        if data == baud:
            raise SystemExit if by_kill else Fault("LINK_LOST")
        if by_kill and data == link.write_of("lock", 1).data:
            raise Fault("LINK_LOST")
        send(data)

    bench.bus.write = write  # type: ignore[method-assign]
    with pytest.raises(SystemExit if by_kill else Fault):
        set_baud(lambda _: nullcontext(bench.bus), link, 500_000, bench.store)
    bench.bus.write = send  # type: ignore[method-assign]
    assert bench.servo.value("lock") == int(not by_kill)
    assert (bench.store.load(link.model) is not None) == by_kill
    bench.another().open()
    assert bench.servo.value("lock") == 1 and bench.servo.eeprom_writes.total() == 0


def test_a_baud_that_a_restart_has_locked_out_is_not_told_to_be_kept() -> None:
    bench = Bench("feetech")
    restarting_ahead_of(bench, bench.driver._link.write_of("baud_rate", 1).data.__eq__)

    @contextmanager
    def opened(baud: int) -> Iterator[VirtualServoBus]:
        bench.bus.set_baud(baud)
        yield bench.bus

    with pytest.raises(Fault, match="DEVICE_RESET"):
        set_baud(opened, bench.driver._link, 500_000, bench.store)
    assert bench.servo.saved("baud_rate") == 0


def test_what_a_run_has_left_is_put_back_before_a_lock_is_opened() -> None:
    bench = Bench("feetech")
    bench.opened()
    put, modes = bench.driver._link.put, list[int]()

    def noted(name: str, value: int) -> None:
        if (name, value) == ("lock", 0):
            modes.append(bench.servo.of("mode"))
        put(name, value)

    bench.driver._link.put = noted  # type: ignore[method-assign]
    set_baud(lambda _: nullcontext(bench.bus), bench.driver._link, 1_000_000, bench.store)
    assert modes == [0]


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("at", ["the torque", "the search for its steps"])
def test_a_duty_that_another_master_writes_as_the_torque_goes_on_takes_it_off_again(protocol: str, at: str) -> None:
    if protocol == "feetech" and at != "the torque":
        return  # it tells no clock: its first tick follows at once
    bench = Bench(protocol)
    bench.opened()
    link, send, goes_on = bench.driver._link, bench.bus.bus.send, list[bool]()
    torque, reading = link.write_of(link.model.roles["torque"], 1).data, bench.driver._sampling.data

    def ahead(data: bytes, t_s: float) -> None:
        if data == torque:
            goes_on.append(True)
        if data == torque if at == "the torque" else goes_on and data == reading:
            bench.servo._set("drive", 100)
        send(data, t_s)

    bench.bus.bus.send = ahead  # type: ignore[method-assign]
    with pytest.raises(Fault, match="ARM_READBACK" if at == "the torque" else "SECOND_MASTER"):
        bench.driver.arm(bench.limits)
    if at == "the torque":
        assert not bench.servo.is_on
    else:
        assert bench.driver.safe_stop() and not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_wrong_answer_is_never_kept_as_what_a_register_held(protocol: str) -> None:
    """An answer does not tell its question, and of a Feetech's damaged ones one in 256 passes."""
    bench = Bench(protocol)
    value, wrong, link = bench.driver._link.value, [1], bench.driver._link
    link.value = lambda name: value(name) + (wrong.pop() if wrong and name == "position_p_gain" else 0)  # type: ignore[method-assign]
    with pytest.raises(Fault, match=r"LINK_REPLY.*position_p_gain"):
        bench.opened()
    assert bench.servo.eeprom_writes.total() == 0 and bench.store.load(bench.setup.model) is None


@pytest.mark.parametrize("at", range(5))
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_wrong_answer_leaves_no_register_as_a_run_has_set_it(protocol: str, at: int) -> None:
    """It may say that a register holds its value of before already."""
    bench = Bench(protocol)
    before = bench.registers()
    bench.armed()
    assert bench.driver.safe_stop()
    link, mode, looks = bench.driver._link, bench.setup.model.roles["mode"], list[int]()
    value = link.value

    def wrong(name: str) -> int:
        looks.append(0) if name == mode else None
        return before[mode] if name == mode and len(looks) == at + 1 else value(name)

    link.value = wrong  # type: ignore[method-assign]
    bench.driver.close()
    assert bench.registers() == before and len(looks) > at


def test_a_packet_that_is_lost_while_a_servos_steps_are_sought_ends_nothing() -> None:
    """Its watchdog would act while rig waits: the run ended with DEVICE_WATCHDOG."""
    bench = Bench()
    bench.opened()
    send, reading, lost = bench.bus.write, bench.driver._sampling.data, [True]

    def write(data: bytes) -> None:
        if not (data == reading and bench.servo.is_on and lost and lost.pop()):
            send(data)

    bench.bus.write = write  # type: ignore[method-assign]
    bench.driver.arm(bench.limits)
    bench.tick(0.3)
    assert not lost and bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_rig_that_opens_the_bus_at_the_same_time_is_told_as_another_master(protocol: str) -> None:
    """It was silent while this one listened: its answers were taken for those of a second servo of this id."""
    bench = Bench(protocol)
    codec = {"dynamixel": dynamixel, "feetech": feetech}[protocol]
    position = bench.setup.model.role("position")
    for k in range(20):
        asks = codec.read(bench.own.id, position.address, position.size)
        bench.bus.bus.another_master(asks, 0.085 + 0.0331 * k)
    with pytest.raises(Fault, match="SECOND_MASTER"):
        bench.opened()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_who_drives_a_servo_on_while_rig_waits_for_its_rest_does_so_no_longer(protocol: str) -> None:
    """It turned for a second, as fast as the run's largest drive, and the run told of a stop."""
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.4)
    drive = bench.driver._link.write_of(bench.setup.model.roles["drive"], 200).data
    waits, at_s = bench.driver._await_rest, list[float]()

    def driven() -> None:
        at_s.append(bench.bus.now_s())
        bench.bus.bus.another_master(drive, bench.bus.now_s() + 0.006)
        waits()

    bench.driver._await_rest = driven  # type: ignore[method-assign]
    assert bench.driver.safe_stop() and not bench.servo.is_on
    bench.bus.sleep_until(bench.bus.now_s() + 0.01)
    assert bench.bus.outputs[0][-1][1] == 0.0 and bench.bus.outputs[0][-1][0] - at_s[0] < 0.05
    assert "another program" in bench.driver.end_words


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_registers_that_could_not_be_put_back_are_told(protocol: str, tmp_path: Path) -> None:
    bench = Bench(protocol, store=BeforeStore(tmp_path / "servo.json"))
    bench.armed()
    bench.driver.safe_stop()
    bench.servo.is_mute = True
    bench.driver.close()
    assert "rig servo restore" in bench.driver.end_words and bench.store.is_kept
