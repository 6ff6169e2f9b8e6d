"""A whole experiment on a servo beside two others, however it ends: nothing stays changed, and no other is driven."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import NoReturn

import pytest
from evidence import evidence
from servo_bench import BYSTANDERS, PROTOCOLS, Bench, addressed

from rig.backends.servo.driver import ServoDriver
from rig.control.loop.runner import Loop
from rig.core.faults import Fault
from rig.running import session
from rig.running.experiment.script import run
from rig.testing.line import on_device


def fails(*_: object) -> NoReturn:
    raise RuntimeError("a defect")


ENDS = {
    "ok": (),
    "no report": ((session, "write_report"),),
    "no result": ((session, "run_result"),),
    "a defect in the loop": ((Loop, "_fresh_reading"),),
}


@pytest.mark.parametrize(("protocol", "ends"), [
    *((p, "a defect in the loop") for p in PROTOCOLS),
    *evidence(*((p, end) for p in PROTOCOLS for end in ENDS if end != "a defect in the loop")),
])  # fmt: skip
def test_after_any_end_all_is_as_it_was_and_no_other_servo_was_touched(
    protocol: str, ends: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(protocol)
    before, others = bench.registers(), [servo.eeprom_writes.total() for servo in bench.bystanders]
    for where, name in ENDS[ends]:
        monkeypatch.setattr(where, name, fails)
    with on_device(bench.bus), contextlib.suppress(RuntimeError):
        outcome = run(bench.e, tmp_path)
        assert (outcome.failure == "") == (ends == "ok"), outcome.failure
    assert bench.registers() == before and not bench.servo.is_on and bench.servo.truth().duty == 0.0
    assert bench.wrong() == []
    assert bench.servo.eeprom_writes.total() <= (4 if protocol == "dynamixel" else 0)
    assert [servo.eeprom_writes.total() for servo in bench.bystanders] == others
    assert all(not servo.is_on and servo.truth().duty == 0.0 for servo in bench.bystanders)
    seen = addressed(bench.bus.bus)  # of the others rig reads an id, once each
    assert {id: seen[id] for id in BYSTANDERS} == dict.fromkeys(BYSTANDERS, 1)


def test_a_wrong_id_is_told_in_what_the_config_of_a_servo_has(tmp_path: Path) -> None:
    bench = Bench(id=3)
    with on_device(bench.bus), pytest.raises(Fault, match="LINK_TIMEOUT") as seen:
        run(bench.e, tmp_path)
    assert "daq.servo.id" in seen.value.cure and "modbus" not in seen.value.cure


def test_the_end_of_a_run_says_that_the_keeper_has_acted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever else ended it."""
    monkeypatch.setattr(Loop, "_fresh_reading", fails)
    monkeypatch.setattr(ServoDriver, "_keeper_acted", property(lambda _: True))
    bench = Bench()
    with on_device(bench.bus):
        outcome = run(bench.e, tmp_path)
    assert outcome.fault is not None and outcome.fault.code == "INTERNAL"
    assert any("keeper" in note for note in outcome.result.notes or ())


def test_the_end_of_a_run_says_that_registers_stay_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> NoReturn:
        raise Fault("LINK_LOST")

    monkeypatch.setattr(Loop, "_fresh_reading", fails)
    monkeypatch.setattr("rig.backends.servo.driver.put_back", lost)
    bench = Bench()
    with on_device(bench.bus):
        outcome = run(bench.e, tmp_path)
    assert any("rig servo restore" in note for note in outcome.result.notes or ())
