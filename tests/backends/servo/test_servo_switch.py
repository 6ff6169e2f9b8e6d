"""A joint that no watchdog stops is driven only after the switch of its supply was seen to cut it."""

from __future__ import annotations

import math
import os
import random
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner
from evidence import evidence
from servo_bench import CONFIGS, PROTOCOLS, Bench
from test_servo_opening import writes

from rig.backends.servo.backend import SERVO
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.line import setup_of
from rig.backends.tick_waits import UNWATCHED_S
from rig.cli import driving, main
from rig.config import load
from rig.control.loop.stop_request import stop_on_signals
from rig.core import person
from rig.core.faults import Fault

SWITCH = {"supply_switch": "the red one"}
OWNERS = 500  # what the register that rig marks held
LOST = {"position_p_gain", "goal_pwm", "torque_limit"}  # what a servo may forget with its supply


class Hand:
    """Does what it is asked for, unless it ``forgets`` that word; in virtual time it has 20 looks.

    pulls  in place of the switch a plug of the bus
    """

    def __init__(self, bench: Bench, forgets: str = "nothing", *, pulls: bool = False) -> None:
        self.bench, self.forgets, self.pulls = bench, forgets, pulls
        self.asked: list[str] = []

    def __call__(self, words: str, is_seen: Callable[[], bool]) -> bool:
        assert len(writes(self.bench)) == 1 and not self.bench.servo.is_on
        self.asked.append(words)
        if self.forgets not in words:
            opens = "open" in words
            if self.pulls:
                self.bench.bus.bus.reply_fault = ReplyFault("deaf", after_s=-math.inf) if opens else None
            else:
                self.bench.bus.power_off() if opens else self.bench.bus.power_cycle()
        return any(is_seen() for _ in range(20))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_switch_is_opened_and_closed_before_anything_is_written(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(protocol, setup=SWITCH)
    before, hand = bench.registers(), Hand(bench)
    monkeypatch.setattr(person, "asks", hand)
    bench.armed()
    bench.tick(0.3)
    assert ["the red one" in words for words in hand.asked] == [True, False]
    bench.driver.safe_stop()
    bench.driver.arm(bench.limits)  # once for all armings of a command
    bench.driver.safe_stop()
    bench.driver.close()
    assert len(hand.asked) == 2 and bench.wrong() == [] and not bench.servo.is_on
    assert {name for name, value in bench.registers().items() if before[name] != value} <= {"goal_pwm"}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(("forgets", "pulls", "words"), [
    ("open", False, "answered on"),
    ("close", False, "did not come back"),
    ("nothing", True, "a plug of its bus was out"),
])  # fmt: skip
def test_a_switch_that_cuts_nothing_or_stays_open_ends_it(
    forgets: str, pulls: bool, words: str, protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(protocol, setup=SWITCH)
    before = bench.registers()
    monkeypatch.setattr(person, "asks", Hand(bench, forgets, pulls=pulls))
    with pytest.raises(Fault, match=f"SERVO_SWITCH_UNTRIED.*{words}"):
        bench.opened()
    bench.driver.safe_stop()
    bench.driver.close()
    is_off = forgets == "close"
    assert bench.registers() == before and (bench.store.load(bench.setup.model) is not None) == is_off
    assert len(writes(bench)) == (1 if is_off else 2) and bench.servo.eeprom_writes.total() == 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_one_lost_answer_is_no_switch_that_cuts(protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(protocol, setup=SWITCH)
    link, marked, lost = bench.driver._link, bench.setup.model.roles["marked"], [True]
    told = link.value_of
    monkeypatch.setattr(
        link, "value_of", lambda id, name: None if name == marked and lost and lost.pop() else told(id, name)
    )
    monkeypatch.setattr(person, "asks", Hand(bench, "open"))
    with pytest.raises(Fault, match="answered on"):
        bench.opened()
    assert not lost


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_who_is_killed_while_a_switch_is_tried_leaves_no_mark_for_good(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(protocol, setup=SWITCH)
    before = bench.registers()

    def killed(*_: object) -> bool:
        monkeypatch.setattr(bench.bus, "write", lambda data: (_ for _ in ()).throw(Fault("LINK_LOST")))
        raise SystemExit

    with monkeypatch.context() as while_it_lives, pytest.raises(SystemExit):
        while_it_lives.setattr(person, "asks", killed)
        bench.opened()
    assert bench.registers() != before
    monkeypatch.undo()
    bench.another().open()
    bench.driver.close()
    assert bench.registers() == before


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_mark_that_nothing_confirms_is_put_back_ends_the_opening(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It went on, and the run's own values took the place of the owner's in the file."""
    bench = Bench(protocol, setup=SWITCH)
    marked, link = bench.setup.model.roles["marked"], bench.driver._link
    bench.servo.put(marked, OWNERS)
    real, held = link.hold, list[int]()

    def hold(name: str, value: int) -> bool:
        held.append(value)
        if held[1:] == [OWNERS]:
            raise Fault("LINK_TIMEOUT")
        return real(name, value)

    monkeypatch.setattr(link, "hold", hold)
    monkeypatch.setattr(person, "asks", Hand(bench))
    with pytest.raises(Fault, match="LINK_TIMEOUT"):
        bench.opened()
    bench.driver.close()
    monkeypatch.setattr(person, "asks", None)
    bench.another().open()
    bench.driver.close()
    assert bench.servo.value(marked) == OWNERS


@pytest.mark.parametrize("share", [0.9, 0.5, 0.3])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_switch_that_leaves_a_part_of_the_supply_cuts_nothing(
    share: float, protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where an adapter feeds the servo, too: 4.5 V of a USB's turn one of 12 V."""
    bench = Bench(protocol, setup=SWITCH)
    supply_V, before = bench.setup.supply_V, bench.registers()

    def hand(words: str, is_seen: Callable[[], bool]) -> bool:
        bench.servo.supply(share * supply_V if "open" in words else supply_V)
        return any(is_seen() for _ in range(20))

    monkeypatch.setattr(person, "asks", hand)
    with pytest.raises(Fault, match=r"SERVO_SWITCH_UNTRIED.*answered on"):
        bench.opened()
    assert bench.registers() == before


@pytest.mark.parametrize("tau_s", [0.2, 2.0, math.inf])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_supply_that_rises_slowly_behind_its_switch_is_waited_for_and_said_so(
    tau_s: float, protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was refused at once. A Dynamixel that was fed too little meanwhile keeps an error until it starts anew.

    What rig had marked it had put back before that start, and so it was lost.
    """
    bench = Bench(protocol, setup=SWITCH)
    supply_V, closed_s, asked, marked = bench.setup.supply_V, math.nan, [], bench.setup.model.roles["marked"]
    bench.servo.put(marked, OWNERS)

    def hand(words: str, is_seen: Callable[[], bool]) -> bool:
        nonlocal closed_s
        asked.append(words)
        if "open" in words:
            bench.bus.power_off()
        elif "close" in words:
            closed_s = bench.bus.now_s() - min(0.5 * tau_s, 1.0)  # at 0.4 of it, or less, the servo begins
            bench.bus.power_cycle()
        for _ in range(200):
            if closed_s > 0.0:
                risen = 0.6 if tau_s == math.inf else 1.0 - math.exp((closed_s - bench.bus.now_s()) / tau_s)
                bench.servo.supply(risen * supply_V)
            if is_seen():
                return True
        return False

    monkeypatch.setattr(person, "asks", hand)
    if tau_s == math.inf:
        with pytest.raises(Fault, match=r"SERVO_(ERROR|SUPPLY)"):
            bench.opened()
        assert bench.bus.now_s() - closed_s < 20.0
    else:
        bench.armed()
        bench.tick(0.3)
        bench.driver.safe_stop()
    bench.driver.close()
    assert f"rises to {supply_V:g} V: rig waits, 10 s at most" in asked[2] or tau_s == 0.2
    assert bench.servo.value(marked) == OWNERS and bench.store.load(bench.setup.model) is None
    assert bench.wrong() == [] and not bench.servo.is_on


class Switch:
    """A supply that changes ahead of a packet: it is cut, and may bounce, or it is another voltage.

    at_s  when it was first not as it must be while the servo was armed, s
    """

    def __init__(self, bench: Bench, phase: int) -> None:
        rng = random.Random(phase)
        self.at_s, self.share = math.inf, rng.choice([0.0, 0.0, 0.5, 1.6])
        self._bench, self._left, self._send = bench, rng.randrange(160), bench.bus.write
        self._closes_s = iter([rng.uniform(0.0, 0.3) for _ in range(rng.choice([0, 1, 5]))])
        self._next_s, self._is_closed, self._has_begun = math.inf, True, False
        bench.bus.write = self._write  # type: ignore[method-assign]  # of this bus alone

    def _write(self, data: bytes) -> None:
        bench, now_s = self._bench, self._bench.bus.now_s()
        self._left -= len(writes(bench)) > 0
        if self._left < 0 and not self._has_begun:
            self._has_begun, self._next_s = True, math.inf if self.share else now_s
            if self.share:
                bench.servo.supply(self.share * bench.setup.supply_V)
        if now_s >= self._next_s:
            self._is_closed = not self._is_closed
            bench.bus.power_cycle() if self._is_closed else bench.bus.power_off()
            self._next_s = now_s + next(self._closes_s, math.inf)
        if bench.driver._armed and self._has_begun and (self.share or not self._is_closed):
            self.at_s = min(self.at_s, now_s)
        self._send(data)

    def mend(self) -> None:
        bench = self._bench
        bench.bus.write = self._send  # type: ignore[method-assign]
        bench.servo.supply(bench.setup.supply_V)
        bench.bus.power_cycle()
        bench.bus.sleep_until(bench.bus.now_s() + 1.0)


def switched(protocol: str, phase: int) -> None:
    bench = Bench(protocol, torque_on_by_goal=True)
    before, outputs, switch = bench.registers(), bench.bus.outputs[0], Switch(bench, phase)
    with suppress(Fault):
        bench.driven(12)
    bench.driver.safe_stop()
    bench.driver.close()
    switch.mend()
    assert not bench.servo.is_on and bench.wrong() == [], phase
    late_s = switch.at_s + (0.0 if switch.share == 0.0 else UNWATCHED_S)
    assert not any(volts for t_s, volts in outputs if t_s > late_s), phase
    bench.another().open()
    bench.driver.close()
    after = bench.registers()
    assert not bench.servo.is_on and {name for name in before if before[name] != after[name]} <= LOST, phase


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(("first", "end"), [(0, 6), *evidence(*((k, k + 24) for k in range(6, 200, 24)))])
def test_a_switch_that_opens_in_a_run_bounces_or_leaves_another_voltage_ends_the_drive_in_the_time_that_is_counted(
    first: int, end: int, protocol: str
) -> None:
    for phase in range(first, end):
        switched(protocol, phase)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_where_nobody_can_be_asked_it_opens_and_does_not_arm(protocol: str) -> None:
    """As an encoder's board without travel limits: `rig doctor` reads it."""
    bench = Bench(protocol, setup=SWITCH)
    bench.opened()
    with pytest.raises(Fault, match="SERVO_SWITCH_UNTRIED"):
        bench.driver.arm(bench.limits)
    assert not bench.servo.is_on and bench.servo.truth().duty == 0.0
    bench.driver.close()


def test_a_run_in_a_pipe_is_refused_before_the_port_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A colour that is asked for makes no terminal of it."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(person, "asks", None)
    text = CONFIGS["feetech"].read_text()
    text = text.replace("port: emulated", "port: /dev/null")
    text = text.replace(
        "    model: sts3215",
        "    model: sts3215\n    attached: joint\n    adapter: native-usb\n    supply_switch: the red one",
    )
    (tmp_path / "bench.yaml").write_text(text)
    for command in ("run", "calibrate"):
        done = CliRunner().invoke(main, [command, str(tmp_path / "bench.yaml")])
        assert done.exit_code == 1 and "the red one" in done.output
        assert "SERVO_SWITCH_UNTRIED" in done.output and f"type `rig {command} CONFIG` in a terminal" in done.output


@pytest.mark.parametrize("sees", [False, True])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_question_at_once(number: int, sees: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(person, "asks", None)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr(driving, "asks_json", lambda: False)
    driving.let_ask(load(CONFIGS["feetech"]).device)
    looks = []

    def is_seen() -> bool:
        looks.append(number)
        os.kill(os.getpid(), number)
        return sees or len(looks) == 2

    with stop_on_signals() as run:
        assert person.asks is not None
        with pytest.raises(Fault, match=f"INTERRUPTED.*{signal.Signals(number).name}"):
            person.asks("open it", is_seen)
    assert len(looks) == 1 and run.reason is None


@pytest.mark.parametrize(("protocol", "port", "attached", "accepts", "needed"), [
    ("feetech", "/dev/ttyACM0", "joint", True, True),
    ("feetech", "/dev/ttyACM0", "load", True, False),
    ("feetech", "emulated", "joint", True, False),
    ("dynamixel", "/dev/ttyUSB0", "joint", True, True),
    ("dynamixel", "/dev/ttyUSB0", "joint", False, False),  # its watchdog works, or nothing drives
])  # fmt: skip
def test_who_must_try_it(protocol: str, port: str, attached: str, accepts: bool, needed: bool) -> None:
    e = Bench(protocol).e
    assert e.daq.servo is not None
    servo = e.daq.servo.model_copy(update={"attached": attached, "supply_switch": "the red one"})
    daq = e.daq.model_copy(update={"port": port, "accept_no_watchdog": accepts, "servo": servo})
    d = e.model_copy(update={"daq": daq}).device
    assert bool(setup_of(d).supply_switch) == needed == any("rig asks you" in note for note in SERVO.notes(d))
