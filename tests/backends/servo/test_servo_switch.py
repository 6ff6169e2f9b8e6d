"""A joint that no watchdog stops is driven only after the switch of its supply was seen to cut it."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from servo_bench import CONFIGS, PROTOCOLS, Bench
from test_servo_opening import writes

from rig.backends.servo.backend import SERVO
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.line import setup_of
from rig.cli import driving, main
from rig.config import load
from rig.control.loop.stop_request import stop_on_signals
from rig.core import person
from rig.core.faults import Fault

SWITCH = {"supply_switch": "the red one"}


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
def test_one_wrong_answer_is_no_switch_that_cuts(protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(protocol, setup=SWITCH)
    link, wrong = bench.driver._link, [0]
    told = link.value_of
    monkeypatch.setattr(
        link,
        "value_of",
        lambda id, name: wrong.pop() if wrong and name == link.model.roles["voltage"] else told(id, name),
    )
    monkeypatch.setattr(person, "asks", Hand(bench, "open"))
    with pytest.raises(Fault, match="answered on"):
        bench.opened()
    assert not wrong


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


def test_a_supply_that_is_as_good_as_gone_counts_as_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the adapter feeds the servo's chip."""
    bench = Bench("feetech", setup=SWITCH)
    supply_V = bench.setup.supply_V

    def hand(words: str, is_seen: Callable[[], bool]) -> bool:
        bench.servo.supply(0.3 * supply_V if "open" in words else supply_V)
        return any(is_seen() for _ in range(20))

    monkeypatch.setattr(person, "asks", hand)
    bench.armed()


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
