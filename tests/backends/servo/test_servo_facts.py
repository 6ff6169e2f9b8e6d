"""`rig servo facts` finds what an emulated servo was told to be, and leaves it as it was."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from evidence import one_of_each
from servo_bench import PROTOCOLS, Bench

from rig.backends.servo.bus import PING_S, servo_link
from rig.backends.servo.facts import Fact, facts
from rig.backends.servo.opening import Opened, set_up
from rig.backends.servo.presence import who_answers


def found(bench: Bench, powered: Any = None) -> dict[str, Fact]:
    before = bench.registers()
    told = {fact.name: fact for fact in facts(bench.driver._link, bench.store, powered)}
    bench.bus.sleep_until(bench.bus.now_s() + 0.5)
    assert {name: value for name, value in bench.registers().items() if name != "lock"} == {
        name: value for name, value in before.items() if name != "lock"
    }
    assert not bench.servo.is_on and bench.wrong() == []
    assert bench.store.load(bench.setup.model) is None
    return told


@pytest.mark.parametrize(("fed_by", "resumes", "stopped"), one_of_each(("any", False, "brake"), ("own", True, "coast")))
def test_what_a_watchdog_does_is_found(fed_by: str, resumes: bool, stopped: str) -> None:
    told = found(Bench(watchdog_fed_by=fed_by, resumes=resumes, stopped_by_watchdog=stopped))
    assert told["watchdog_stops"].found is True
    assert told["watchdog_fed_by"].found == fed_by
    assert told["watchdog_resumes"].found is resumes
    slows_s = told["slows_s_watchdog"].found  # a reading within its time fed it: then it was told to take 0.5 s
    assert isinstance(slows_s, float) and 0.02 < slows_s < 0.2


def test_a_horn_that_no_watchdog_slows_down_is_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of one whose watchdog worked when it was proven."""
    bench = Bench()

    def proven(*given: Any) -> Opened:
        opened = set_up(*given)
        bench.servo.options = dataclasses.replace(bench.servo.options, watchdog_defect=True)
        return opened

    monkeypatch.setattr("rig.backends.servo.facts.set_up", proven)
    told = found(bench)["slows_s_watchdog"]
    assert told.found is None and "did not fall" in told.words


def test_a_watchdog_that_does_not_work_is_told() -> None:
    told = found(Bench(watchdog_defect=True))
    assert told["watchdog_stops"].found is False and "drives on" in told["watchdog_stops"].words
    assert "slows_s_watchdog" not in told


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_how_soon_it_slows_down_and_tells_a_duty(protocol: str) -> None:
    told = found(Bench(protocol))
    for name, most_s in (("slows_s_duty_0", 0.5), ("slows_s_torque_off", 0.5), ("duty_told_after_s", 0.01)):
        seen_s = told[name].found
        assert isinstance(seen_s, float) and 0.0 < seen_s < most_s


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_how_old_a_position_is_shows_in_the_starts_of_a_horn(protocol: str) -> None:
    """Of a servo whose reading is 4 ms late, beside one that tells the position of its last step."""
    fresh, old = Bench(protocol), Bench(protocol)
    tick, refresh, servo = old.servo._tick, old.servo._refresh, old.servo
    kept = [old.own.zero_counts] * 5

    def ticked() -> None:
        tick()
        refresh()
        kept.append(servo.value("present_position"))
        del kept[0]

    def late() -> None:
        refresh()
        servo.put("present_position", kept[0])

    servo._tick, servo._refresh = ticked, late  # type: ignore[method-assign]  # of this one
    seen = [found(bench)["moves_after_s"].found for bench in (fresh, old)]
    assert isinstance(seen[0], float) and isinstance(seen[1], float)
    assert 0.0 <= seen[0] < 0.003 and seen[1] - seen[0] == pytest.approx(0.004, abs=0.001)


def test_a_held_horn_is_told() -> None:
    bench = Bench()
    bench.servo.bench.parameters = bench.servo.bench.parameters.__class__(
        **{**vars(bench.servo.bench.parameters), "stop_rad": (-1e-6, 1e-6)}
    )
    told = found(bench)
    assert told["slows_s_duty_0"].found is None and told["moves_after_s"].found is None


def test_a_feetech_forgets_its_mode_with_its_supply() -> None:
    bench = Bench("feetech")

    def powered() -> None:
        bench.bus.power_cycle()
        bench.bus.sleep_until(bench.bus.now_s() + 1.0)

    told = found(bench, powered)
    assert told["lock_keeps_mode"].found is False
    assert told["least_duty"].found is not None


@pytest.mark.parametrize("protects", [True, False])
def test_whether_a_feetech_protects_itself_in_pwm_mode_is_found(protects: bool) -> None:
    bench = Bench("feetech", protects_in_pwm=protects)
    assert found(bench, lambda: bench.bus.sleep_until(bench.bus.now_s() + 1.0))["protects_in_pwm"].found is protects
    assert protects or "protects_in_pwm" not in found(bench)  # without somebody at its supply


def test_what_a_step_of_p_means_is_measured_of_a_feetech_whose_i_is_0() -> None:
    """Also of one whose torque a goal switches on: it is left off."""
    bench = Bench("feetech", torque_on_by_goal=True)
    assert found(bench)["p_scale_1_rad"].found == pytest.approx(0.166, rel=0.06)
    told = found(Bench("feetech", registers={"position_i_gain": 3}))["p_scale_1_rad"]
    assert told.found is None and "its I is 3" in told.words


# in the middle of its turn; so near the end that goals lie on one side
@pytest.mark.parametrize(("divisor", "at"), one_of_each((128.0, 2048), (256.0, 10)))
def test_what_a_step_of_p_means_is_measured(divisor: float, at: int) -> None:
    bench = Bench(p_divisor=divisor, zero_counts=at)
    scale = found(bench)["p_scale_1_rad"].found
    assert scale == pytest.approx(4096 / (2.0 * math.pi) / 885 / divisor, rel=0.06)


def test_a_position_mode_that_gives_no_duty_is_told() -> None:
    told = found(Bench(p_divisor=1e6))["p_scale_1_rad"]
    assert told.found is None and "gave no duty" in told.words


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("adapter_s", [0.0, 0.016, 0.06])  # an FTDI as it comes: answers come while another id is asked
def test_a_scan_finds_each_servo_once_however_late_its_answer_comes(protocol: str, adapter_s: float) -> None:
    bench = Bench(protocol)
    bench.bus.bus.line = dataclasses.replace(bench.bus.bus.line, adapter_s=adapter_s)
    ids = range(12)
    link = servo_link(bench.bus, bench.setup.model, 0, bench.own.baud)
    assert sorted(id for id, _ in who_answers(link, ids)) == (
        [1, 4, 7] if adapter_s < 0.05 else []
    )  # too late is no fault


def test_a_scan_finds_a_servo_whose_answer_came_while_the_host_stood_still() -> None:
    """The answer of id 1 before id 2 is asked; that of id 7, the last, after all."""
    bench = Bench()
    bench.bus.bus.line = dataclasses.replace(bench.bus.bus.line, adapter_s=0.006)
    link = servo_link(bench.bus, bench.setup.model, 0, bench.own.baud)
    asked = link.is_there

    def late(id: int, patience_s: float = PING_S) -> tuple[int, ...] | None:
        if id == 2:
            bench.bus.sleep_until(bench.bus.now_s() + 0.03)
        return asked(id, patience_s)

    link.is_there = late  # type: ignore[method-assign]
    assert sorted(id for id, _ in who_answers(link, range(8))) == [1, 4, 7]
