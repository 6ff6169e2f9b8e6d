"""After any end a servo's registers are those of before, and no other servo on the bus was touched."""

from __future__ import annotations

import contextlib
import errno
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn
from unittest.mock import Mock

import pytest
from evidence import evidence
from servo_bench import BYSTANDERS, PROTOCOLS, Bench, Keeper, addressed

from rig.backends.servo import opening
from rig.backends.servo.before import BeforeStore, back_of, put_back, values_of
from rig.backends.servo.bus import Ask, ServoLink
from rig.backends.servo.facts import facts
from rig.backends.servo.line import servo_of
from rig.backends.servo.link_budget import longest_return_delay_s
from rig.backends.servo.packets import LAST_ID
from rig.backends.servo.scan import restore
from rig.core.faults import Fault

NEVER = {"id", "baud_rate", "homing_offset", "min_position_limit", "max_position_limit", "secondary_id", "drive_mode"}
MOST_WRITES = 2  # of each register of the EEPROM: changed, and put back
# of the EEPROM in a run on a servo as shipped: mode and limit; a Feetech's lock keeps all of it out of there
ALL_WRITES = {"dynamixel": 4, "feetech": 0}
LAST_STEP = 60  # of the writes of an opening and a run: all of them are fewer


class Killed(BaseException):
    """The command ends here, as by kill -9: nothing that is written in Python runs any more."""


def owned(bench: Bench) -> dict[str, int]:
    """As of before, but what a mode change sets by itself."""
    return bench.registers()


def run(bench: Bench) -> None:
    bench.driven(8)
    bench.driver.safe_stop()
    bench.driver.close()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_run_leaves_every_register_as_it_was_and_writes_little(protocol: str) -> None:
    bench = Bench(protocol)
    bench.servo.put("position_p_gain", 123)  # somebody's own tuning
    before, others = owned(bench), [bytes(servo._active) for servo in bench.bystanders]
    run(bench)
    assert owned(bench) == before
    written = bench.servo.eeprom_writes
    assert not written.keys() & NEVER
    assert all(count <= MOST_WRITES for count in written.values()), written
    assert written.total() <= ALL_WRITES[protocol], written
    end = 64 if protocol == "dynamixel" else 56  # beyond it is what the servo measures
    assert [bytes(s._active[:end]) for s in bench.bystanders] == [one[:end] for one in others]
    assert all(s.eeprom_writes.total() == 0 and not s.is_on for s in bench.bystanders)
    assert bench.wrong() == []
    assert bench.store.load(bench.setup.model) is None
    # of the others it read an id, once each: of a Dynamixel the second one
    seen = addressed(bench.bus.bus)
    assert {id: seen[id] for id in BYSTANDERS} == dict.fromkeys(BYSTANDERS, 1)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_second_run_writes_no_more_than_the_first(protocol: str) -> None:
    bench = Bench(protocol)
    run(bench)
    first = bench.servo.eeprom_writes.copy()
    bench.another()
    run(bench)
    assert all(count <= 2 * first[name] for name, count in bench.servo.eeprom_writes.items())


@pytest.mark.parametrize(
    ("shipped", "setup", "writes"),
    [
        ({}, {"fastest_slope": True}, {"operating_mode", "pwm_limit", "pwm_slope"}),
        ({}, {"longest_delay_s": 0.0}, {"operating_mode", "pwm_limit", "return_delay_time"}),
        ({"return_delay_time": 0}, {"longest_delay_s": 0.0}, {"operating_mode", "pwm_limit"}),
        ({"pwm_slope": 255}, {"fastest_slope": True}, {"operating_mode", "pwm_limit"}),
        ({"operating_mode": 16}, {}, {"pwm_limit"}),
    ],
)
def test_only_what_differs_is_written_and_put_back(
    shipped: dict[str, int], setup: dict[str, float], writes: set[str]
) -> None:
    bench = Bench(registers=shipped, setup=setup)
    before = owned(bench)
    if "operating_mode" in shipped:
        before["goal_pwm"] = 0  # in PWM mode it is the duty: the end leaves 0
    run(bench)
    assert owned(bench) == before and bench.wrong() == []
    assert bench.servo.eeprom_writes == dict.fromkeys(writes, 2)


@pytest.mark.parametrize("is_killed", [False, True])
@pytest.mark.parametrize(("goal", "value", "limit"), [
    ("goal_pwm", 600, "pwm_limit"), ("goal_pwm", -600, "pwm_limit"),
    ("goal_current", 600, "current_limit"), ("goal_velocity", -400, "velocity_limit"),
])  # fmt: skip
def test_a_goal_beyond_a_limit_that_was_lowered_since_is_put_back_to_that(
    goal: str, value: int, limit: str, is_killed: bool, tmp_path: Path
) -> None:
    """It is refused by now: nothing would ever be put back."""
    bench = Bench()
    bench.servo.put(goal, value)
    if not is_killed or limit == "pwm_limit":  # else somebody lowers it after the run
        bench.servo.put(limit, 300)
    before = owned(bench)
    if is_killed:
        store = left_by_a_killed_run(bench, tmp_path)
        bench.servo.put(limit, 300 if limit != "pwm_limit" else bench.servo.of("max_drive"))
        restore(bench.another()._link, store)
    else:
        run(bench)
    assert bench.servo.value(goal) == (300 if value > 0 else -300) and not bench.store.is_kept
    assert owned(bench) == before | {limit: 300} | ({goal: bench.servo.value(goal)} if goal in before else {})


@pytest.mark.parametrize("step", [*range(9), 60])
@pytest.mark.parametrize("mode", [3, 16])
def test_the_watchdog_that_somebody_has_set_is_set_behind_a_run_and_one_that_was_killed(
    mode: int, step: int, tmp_path: Path
) -> None:
    """Who has set it once relies on it."""
    bench = Bench(store=BeforeStore(tmp_path / "servo.json"))
    bench.servo.put("bus_watchdog", 50)
    bench.servo.put("operating_mode", mode)
    if mode == 16:  # and its limit is the run's: nothing of a run shows
        bench.servo._set("max_drive", bench.setup.max_units)
        bench.servo._set("drive", 0)
    before, put, left = owned(bench), bench.driver._link.put, step

    def killed(name: str, value: int) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise Killed
        put(name, value)

    bench.driver._link.put = killed  # type: ignore[method-assign]  # of this link alone
    with contextlib.suppress(Killed):
        run(bench)
    if step < 60:
        restore(bench.another()._link, BeforeStore(bench.store.path))
    assert owned(bench) == before and not bench.servo.is_on


def test_an_end_that_an_older_rig_left_half_done_is_gone_on_with(tmp_path: Path) -> None:
    """It put the mode back last, and named that alone from there on: gains are as the mode has reset them."""
    bench = Bench(store=BeforeStore(tmp_path / "servo.json"))
    bench.servo.put("position_p_gain", 123)
    before, values = owned(bench), values_of(bench.driver._link)
    order = ("pwm_slope", "pwm_limit", "return_delay_time", "operating_mode", "goal_pwm")
    registers = {name: values[name] for name in (*order, *(name for name in values if name not in order))}
    for mode, sets in ((3, {}), (16, {}), (16, {"pwm_limit": [bench.setup.max_units]})):
        bench.store.save(bench.setup.model, 1, registers, {**sets, "operating_mode": [16]})
        bench.servo.put("operating_mode", mode)
        bench.servo.put("position_p_gain", 400)
        restore(bench.another()._link, BeforeStore(bench.store.path))
        assert owned(bench) == before and not bench.store.is_kept, (mode, sets)


def test_another_servo_of_pwm_mode_is_no_end_that_was_killed_half_way(tmp_path: Path) -> None:
    """Until the limit is back rig leaves none in that mode."""
    store = left_by_a_killed_run(Bench(), tmp_path)
    other = Bench(store=store, registers={"operating_mode": 16})
    before = other.registers()
    with pytest.raises(Fault, match=r"SERVO_CHANGED.*pwm_limit") as raised:
        restore(other.driver._link, store)
    assert "is put back" not in raised.value.detail  # no value in the file would do
    assert other.registers() == before and other.servo.eeprom_writes.total() == 0 and store.is_kept


def test_a_killed_run_and_its_keeper_write_the_eeprom_five_times() -> None:
    """Limit and mode; the keeper, which does not look first, the limit twice. Not what the run has left alone."""
    bench = Bench()
    keeper = bench.driver._start_guardian = Keeper(bench)
    bench.armed()
    assert keeper.stop() and keeper.restore()
    assert bench.servo.eeprom_writes == {"pwm_limit": 3, "operating_mode": 2}


def test_what_the_keeper_would_put_back_is_known_before_anything_is_written() -> None:
    """It starts then: what the servo holds at that time says nothing of what will be changed."""
    bench = Bench()
    orders: list[set[str]] = []

    def watched(link: ServoLink, store: BeforeStore) -> NoReturn:
        values = store.load(link.model)
        assert values is not None and bench.servo.eeprom_writes.total() == 0
        early, middle, last, _ = back_of(link.model, values, {})
        orders.append({name for name, _ in early + middle + last})
        raise Fault("SERVO_UNWATCHED", "no keeper")

    bench.driver._start_guardian = watched
    with pytest.raises(Fault, match="SERVO_UNWATCHED"):
        bench.opened()
    assert {"operating_mode", "pwm_limit", "pwm_slope", "return_delay_time", "position_p_gain"} <= orders[0]


def test_a_return_delay_that_the_tick_has_no_room_for_is_set_to_0() -> None:
    """2 x 0.5 ms beside the exchange of 0.9 ms fit 80 % of 10 ms, not of 2 ms."""
    e = Bench().e
    servo = servo_of(e.device)
    assert longest_return_delay_s(e.daq, servo, 0.010) > 0.5e-3 > longest_return_delay_s(e.daq, servo, 0.002)
    assert longest_return_delay_s(e.daq, servo, 0.0005) == 0.0
    bench = Bench(setup={"longest_delay_s": 0.0})
    bench.opened()
    assert "each run sets 0" in bench.driver.link_words["return delay"]


def killed_at(protocol: str, step: int, tmp_path: Path) -> bool:
    """End a run just before its write of that number, then run again. Whether there was such a write."""
    store = BeforeStore(tmp_path / f"servo-{step}.json")
    bench = Bench(protocol, store=store)
    bench.servo.put("position_p_gain", 123)
    before = owned(bench)
    left = step
    real = bench.bus.write

    def write(data: bytes) -> None:
        nonlocal left
        if data[7 if protocol == "dynamixel" else 4] == 3:  # an instruction that writes
            left -= 1
            if left < 0:
                raise Killed
        real(data)

    bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
    try:
        run(bench)
    except Killed:
        pass
    else:
        return False
    bench.bus.write = real  # type: ignore[method-assign]
    bench.bus.sleep_until(bench.bus.now_s() + 0.5)
    bench.store = BeforeStore(store.path)  # another process
    bench.another()
    run(bench)
    assert owned(bench) == before, step
    assert not bench.servo.is_on and bench.wrong() == []
    assert not bench.servo.eeprom_writes.keys() & NEVER
    return True


@pytest.mark.parametrize(("protocol", "step"), [
    *((p, s) for p in PROTOCOLS for s in (0, 1, 4, 7, 12)),
    *evidence(*((p, s) for p in PROTOCOLS for s in range(LAST_STEP) if s not in (0, 1, 4, 7, 12))),
])  # fmt: skip
def test_a_run_that_is_killed_anywhere_is_put_right_by_the_next(protocol: str, step: int, tmp_path: Path) -> None:
    there = killed_at(protocol, step, tmp_path)
    assert there or step > 12


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_opening_that_puts_back_asks_no_id_more_often_than_another(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To ask all of them takes seconds."""
    monkeypatch.setattr(opening, "LAST_ID", LAST_ID)
    bench, absent, pings = Bench(protocol), LAST_ID, list[int]()
    asks = bench.driver._bus.ping(absent).data
    for _ in range(2):
        written: list[bytes] = []
        send = bench.bus.write
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bench.bus, "write", lambda data, w=written, s=send: (w.append(data), s(data)))
            bench.another().open()
        pings.append(written.count(asks))
    assert pings[0] == pings[1] > 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_nothing_is_written_to_a_servo_that_falls_silent_before_its_values_are_kept(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even a stop: in another mode the register of the duty means something else."""
    bench = Bench(protocol)
    before = owned(bench)

    def looked(*_: object) -> tuple[str, ...]:
        bench.servo.is_mute = True  # it hears, and does what it hears
        return ()

    monkeypatch.setattr("rig.backends.servo.driver.look", looked)
    with pytest.raises(Fault, match="LINK_TIMEOUT"):
        bench.opened()
    bench.driver.safe_stop()
    bench.driver.close()
    assert owned(bench) == before and bench.servo.eeprom_writes.total() == 0


@pytest.mark.parametrize(("protocol", "first"), [
    *((p, 0) for p in PROTOCOLS), *evidence(*((p, f) for p in PROTOCOLS for f in range(1, 201, 50))),
])  # fmt: skip
def test_what_the_keeper_writes_stops_a_servo_and_puts_it_back_wherever_the_run_was_killed(
    protocol: str, first: int
) -> None:
    """Ahead of any of its writes, or of the time after one. The keeper looks at the mode alone before it writes."""
    for phase in range(first, first + 50) if first else (7, 9, 60):
        rng = random.Random(phase)
        bench = Bench(protocol, resumes=rng.random() < 0.5)
        bench.servo.put("position_p_gain", 123)
        before, left, real = owned(bench), phase % LAST_STEP if phase < 2 * LAST_STEP else phase, bench.bus.write
        duty = bench.servo.of("drive")
        keeper = bench.driver._start_guardian = Keeper(bench)

        def write(data: bytes, bench: Bench = bench, real: Callable[[bytes], None] = real) -> None:
            nonlocal left
            left -= data[7 if bench.setup.model.protocol == "dynamixel" else 4] == 3  # an instruction that writes
            if left < 0:
                raise Killed
            real(data)

        bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
        with contextlib.suppress(Killed):
            run(bench)
        bench.bus.write = real  # type: ignore[method-assign]
        if left >= 0:
            continue  # it had no such write
        bench.bus.sleep_until(bench.bus.now_s() + rng.choice([0.0, rng.uniform(0.0, 0.02), 0.2]))
        if keeper._stop:  # else it was killed before anything was written
            assert keeper.stop()
            bench.bus.sleep_until(bench.bus.now_s() + 0.002)  # the servo's step
            assert not bench.servo.is_on and bench.servo.truth().duty == 0.0, phase
            assert keeper.restore(), phase
            assert bench.servo.of("drive") in (0, duty), phase  # not rig's
        assert owned(bench) == before and not bench.servo.is_on and bench.wrong() == [], phase
        seen = addressed(bench.bus.bus)
        assert max(seen[id] for id in BYSTANDERS) <= 1, phase
        assert not any(one.is_on or one.eeprom_writes for one in bench.bystanders), phase


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_late_answer_to_another_write_of_the_keeper_confirms_none_that_was_lost(protocol: str) -> None:
    """A servo that is left in PWM mode unseen drives as soon as another program switches its torque on."""
    lost, orders = 2, 2
    while lost <= orders:
        bench = Bench(protocol)
        keeper, before, asked = Keeper(bench), owned(bench), 0
        bench.driver._start_guardian = keeper
        bench.armed()
        assert keeper.stop()
        orders, lost = len(keeper._restore), lost + 1

        def spoilt(direction: str, data: bytes, _: float, lost: int = lost - 1) -> list[tuple[float, bytes]]:
            nonlocal asked
            asked += direction == "request"
            if direction == "request" and asked == lost:
                return []
            return [(0.0, data), (0.003, data)] if asked == lost - 1 else [(0.0, data)]

        bench.bus.bus.disturbance = spoilt
        restored = keeper.restore()
        assert not bench.servo.is_on and (not restored or owned(bench) == before), lost - 1


def test_a_watchdog_that_has_acted_is_cleared_though_a_late_answer_to_another_write_says_so() -> None:
    """While it has acted the next program's goals are refused."""
    bench = Bench()
    before = bench.registers()
    bench.opened()
    bench.servo.put("bus_watchdog", -1)
    asks, lost = b"", 0

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        nonlocal asks, lost
        if direction == "reply":
            return [(0.0, data), (5e-4, data)] if asks[7:9] == b"\x03\x40" else [(0.0, data)]  # of torque off
        asks, is_lost = data, data[7:9] == b"\x03\x62" and lost == 0
        lost += is_lost
        return [] if is_lost else [(0.0, data)]

    bench.bus.bus.disturbance = late
    bench.driver.close()
    assert lost == 1 and bench.registers() == before


def test_a_goal_that_a_keeper_has_stopped_in_another_mode_is_put_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run was killed before it had changed anything, and the bus failed behind the stop: nothing else tells."""
    bench = Bench(store=BeforeStore(tmp_path / "servo.json"))
    before, keeper = bench.registers(), Keeper(bench)
    bench.driver._start_guardian = keeper
    monkeypatch.setattr(bench.driver._link, "put", Mock(side_effect=Killed))
    with pytest.raises(Killed):
        bench.opened()
    assert keeper.stop() and bench.servo.value("goal_pwm") == 0
    monkeypatch.undo()
    restore(bench.another()._link, BeforeStore(bench.store.path))
    assert bench.registers() == before


def test_the_last_that_a_keeper_writes_is_torque_off() -> None:
    """A duty that is put back may have switched it on."""
    bench = Bench("feetech", torque_on_by_goal=True)
    bench.servo._set("mode", bench.setup.model.pwm_mode)
    keeper = bench.driver._start_guardian = Keeper(bench)
    bench.armed()
    assert keeper.stop() and keeper.restore() and not bench.servo.is_on


def test_the_next_run_tells_what_the_keeper_did(tmp_path: Path) -> None:
    bench = Bench(store=BeforeStore(tmp_path / "servo.json"))
    bench.driver._start_guardian = keeper = Keeper(bench)
    assert bench.store.note_path is not None
    keeper.tell("", str(bench.store.note_path), stopped=True, restored=True)
    assert any("stopped it" in remark for remark in bench.opened().remarks)


def test_nothing_is_written_where_the_values_of_before_cannot_be_kept(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    bench = Bench(store=BeforeStore(tmp_path / "file" / "servo.json"))
    with pytest.raises(Fault, match="SERVO_CHANGED"):
        bench.opened()
    assert bench.servo.eeprom_writes.total() == 0 and bench.servo.of("mode") == 3


@pytest.mark.parametrize("text", ["", "{", "[]", '{"model": "xl330-m288"}', '{"model": "sts3215", "registers": {}}',
                                  '{"model": "xl330-m288", "registers": {"id": 3}}',
                                  '{"model": "xl330-m288", "registers": {"pwm_limit": 99999}}',
                                  '{"model": "xl330-m288", "registers": {"pwm_limit": 1e999}}',
                                  '{"model": "xl330-m288", "registers": {"pwm_limit": 300}}',
                                  '{"model": "xl330-m288", "registers": {"pwm_limit": 300}, "set": {"pwm_limit": 7}}',
                                  "[" * 100_000])  # fmt: skip
def test_a_file_that_is_damaged_or_of_another_servo_is_not_believed(text: str, tmp_path: Path) -> None:
    path = tmp_path / "servo.json"
    path.write_text(text)
    bench = Bench(store=BeforeStore(path))
    with pytest.raises(Fault, match="SERVO_CHANGED"):
        bench.opened()
    bench.driver.safe_stop()
    bench.driver.close()
    assert path.read_text() == text and bench.servo.eeprom_writes.total() == 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_values_that_another_servo_left_are_not_written_to_this_one(protocol: str, tmp_path: Path) -> None:
    """A servo of another model has come to the same port and id: nothing is written before that is seen."""
    store = BeforeStore(tmp_path / "servo.json")
    bench = Bench(protocol, store=store)
    bench.armed()
    name = {"dynamixel": "xl330-m077", "feetech": "sts3250"}[protocol]
    other = Bench(protocol, store=BeforeStore(store.path), model=name)
    with pytest.raises(Fault, match="CONFIG_MISMATCH"):
        other.opened()
    other.driver.close()
    assert other.servo.eeprom_writes.total() == 0 and store.load(bench.setup.model) is not None


def left_by_a_killed_run(bench: Bench, tmp_path: Path) -> BeforeStore:
    """A run of this bench is killed while it is armed. The file as the next command finds it."""
    bench.store.path = tmp_path / "servo.json"
    bench.armed()
    return BeforeStore(bench.store.path)


KINDS = ["as shipped", "PWM mode", "its limit is the run's", "a goal of a velocity"]
WHO = ["the end", "the next command", "its keeper", "its keeper ahead of all"]
PUT_BACK = [(p, kind, who) for p in PROTOCOLS for kind in KINDS for who in WHO if p == "dynamixel" or kind != KINDS[3]]


def kept_as(protocol: str, kind: str, store: BeforeStore) -> Bench:
    """A servo as somebody has set it."""
    bench = Bench(protocol, store=store, torque_on_by_goal=True)
    model, servo = bench.setup.model, bench.servo
    servo.put("position_p_gain", 123)
    if kind == "PWM mode":
        servo._set("mode", model.pwm_mode)
        servo._set("drive", 0)
    elif kind == "its limit is the run's":
        for role in ("max_drive", "drive") if protocol == "dynamixel" else ("max_drive",):
            servo._set(role, bench.setup.max_units)
    elif kind == "a goal of a velocity":
        servo._set("mode", 1)
        servo.put("goal_velocity", 33)
    return bench


def all_of(bench: Bench) -> dict[str, int]:
    return {r.name: bench.servo.value(r.name) for r in bench.setup.model.registers.values() if r.access == "rw"}


def putting_back(bench: Bench, who: str) -> Callable[[int], object]:
    """A run that is over, or was killed while it drove; what puts the servo back, killed ahead of that write."""
    keeper = bench.driver._start_guardian = Keeper(bench)
    if who == WHO[-1]:
        with pytest.MonkeyPatch.context() as patch, contextlib.suppress(Killed):
            patch.setattr(bench.driver._link, "put", Mock(side_effect=Killed))
            bench.opened()
    else:
        bench.armed()
        bench.tick(0.3)
    if who.startswith("its keeper"):
        assert keeper.stop()
        orders, keeper._restore = keeper._restore, ()

        def given(most: int) -> bool:
            keeper._restore = orders[:most]
            return keeper.restore() and most >= len(orders)

        return given
    if who == "the end":
        bench.driver.safe_stop()
    driver, writes = bench.driver if who == "the end" else bench.another(), 0
    put, protocol = bench.bus.write, bench.setup.model.protocol

    def ended(most: int) -> bool:
        def write(data: bytes) -> None:
            nonlocal writes
            if (
                data[7 if protocol == "dynamixel" else 4] == 3
                and bench.own.id == data[4 if protocol == "dynamixel" else 2]
            ):
                writes += 1
                if writes > most:
                    raise Killed
            put(data)

        with pytest.MonkeyPatch.context() as patch, contextlib.suppress(Killed):
            patch.setattr(bench.bus, "write", write)
            put_back(driver._link, bench.store, is_left=who != "the end")
        return writes <= most

    return ended


@pytest.mark.parametrize(("protocol", "kind", "who"), PUT_BACK)
def test_until_all_is_back_no_goal_is_left_beside_its_limit_and_no_torque(
    protocol: str, kind: str, who: str, tmp_path: Path
) -> None:
    """At every packet: a servo that is left there, whoever comes next, drives nowhere."""
    bench = kept_as(protocol, kind, BeforeStore(tmp_path / "servo.json"))
    before, servo, wrong, was_off = all_of(bench), bench.servo, list[str](), False
    ended, send = putting_back(bench, who), bench.bus.bus.send
    drive, limit = bench.setup.model.roles["drive"], bench.setup.model.roles["max_drive"]

    def look(data: bytes, t_s: float) -> None:
        nonlocal was_off
        was_off = was_off or not servo.is_on
        is_back = servo.value(limit) == before[limit] and kind != "its limit is the run's"
        rest = {name for name, value in owned(bench).items() if value != before[name]} - {drive, "torque_enable"}
        # on some servos the write of duty 0 switches the torque on, for one packet
        is_pwm = servo.of("mode") == bench.setup.model.pwm_mode and not (is_back and who == "its keeper")
        may_drive = servo.is_on and (servo.value(drive) != 0 or not is_pwm)
        if was_off and (may_drive or (is_back and (rest or servo.value(drive) != 0))):
            wrong.append(f"{servo.value(drive)}, {servo.value(limit)}, {servo.is_on}, {data.hex(' ')}")
        send(data, t_s)

    bench.bus.bus.send = look  # type: ignore[method-assign]
    assert ended(1000) and not servo.is_on and bench.wrong() == []
    owners = f"{before[drive]}, {before[limit]}, False"  # as it was, and once all is back
    assert [one for one in wrong if not one.startswith(owners)] == [] and owned(bench) == {
        name: before[name] for name in owned(bench)
    }


@pytest.mark.parametrize(("protocol", "kind", "who", "step"), [
    *((*one, 3) for one in PUT_BACK), *evidence(*((*one, 1) for one in PUT_BACK)),
])  # fmt: skip
def test_another_servo_of_the_same_values_gets_none_wherever_the_putting_back_was_killed(
    protocol: str, kind: str, who: str, step: int, tmp_path: Path
) -> None:
    """It would have the first one's gains and goals. The first one gets all of them once it is there again."""
    most, is_over = 0, False
    while not is_over:
        store = BeforeStore(tmp_path / "servo.json")
        first, other = kept_as(protocol, kind, store), kept_as(protocol, kind, BeforeStore(store.path))
        if protocol == "dynamixel":  # of a Feetech it is kept without supply: another one is refused
            other.servo.put("position_p_gain", 77)
        before, others = owned(first), all_of(other)
        is_over = putting_back(first, who)(most) is True
        if store.path is not None and store.path.exists():
            restore(other.driver._link, other.store)
            assert all_of(other) == others and other.wrong() == [], most
            if other.store.aside_path is not None:
                other.store.aside_path.replace(store.path)
            first.bus.sleep_until(first.bus.now_s() + 0.5)
            restore(first.another()._link, BeforeStore(store.path))
        assert owned(first) == before and not first.servo.is_on and first.wrong() == [], most
        for path in tmp_path.iterdir():
            path.unlink()
        most += step


@pytest.mark.parametrize("opens", [True, False])
@pytest.mark.parametrize(("protocol", "name", "value"), [
    ("dynamixel", "pwm_limit", 600), ("dynamixel", "operating_mode", 4), ("dynamixel", "pwm_slope", 99),
    ("dynamixel", "return_delay_time", 10), ("feetech", "mode", 1), ("feetech", "position_p_gain", 77),
])  # fmt: skip
def test_another_servo_of_the_same_model_and_id_is_written_nothing(
    protocol: str, name: str, value: int, opens: bool, tmp_path: Path
) -> None:
    """It holds neither what the first held before, nor what rig has set: two adapters have changed their places."""
    store = left_by_a_killed_run(Bench(protocol), tmp_path)
    other = Bench(protocol, store=store, registers={name: value})
    before = other.registers()
    with pytest.raises(Fault) as raised:
        other.opened() if opens else restore(other.driver._link, store)
    other.driver.close()
    fault = raised.value
    assert fault.code == "SERVO_CHANGED" and name in fault.detail and f"reads {value}" in fault.detail
    assert str(store.path) in fault.detail and store.is_kept
    assert other.registers() == before and other.servo.eeprom_writes.total() == 0


def test_another_servo_as_shipped_gets_no_gains_of_the_one_that_was_there(tmp_path: Path) -> None:
    """All that is kept without supply is alike: that nothing is as rig has set it tells the other one."""
    first = Bench()
    first.servo.put("position_p_gain", 123)
    store = left_by_a_killed_run(first, tmp_path)
    other = Bench(store=store)
    before = other.registers()
    info = other.opened()
    assert any("nothing of that run is left" in remark for remark in info.remarks)
    other.driver.close()
    assert other.registers() == before and not store.is_kept
    # the first one comes back: its values are still there, as the remark has said
    assert store.path is not None and store.aside_path is not None and str(store.aside_path) in " ".join(info.remarks)
    store.aside_path.rename(store.path)
    first.driver.safe_stop()
    restore(first.another()._link, BeforeStore(store.path))
    assert first.servo.of("mode") == 3 and first.servo.value("position_p_gain") == 123 and not store.is_kept


def test_values_of_one_servo_after_the_other_stay_beside_and_in_a_read_only_folder_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, store, kept = Bench().setup.model, BeforeStore(tmp_path / "servo-a-1.json"), []
    for gain in (1, 2, 3):
        store.save(model, 1, {"position_p_gain": gain})
        if gain == 3:
            monkeypatch.setattr(Path, "replace", Mock(side_effect=OSError(errno.EROFS, "")))
        store.set_aside()
        assert store.aside_path is not None
        kept.append(store.aside_path)
    assert [json.loads(path.read_text())["registers"]["position_p_gain"] for path in kept] == [1, 2, 3]


def test_what_a_keeper_says_is_told_though_its_folder_is_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = BeforeStore(tmp_path / "servo-a-1.json")
    assert store.note_path is not None
    store.note_path.write_text("stopped it", encoding="utf-8")
    monkeypatch.setattr(Path, "unlink", Mock(side_effect=OSError(errno.EROFS, "")))
    assert store.note() == "stopped it"


def test_gains_of_who_has_changed_the_mode_back_since_a_killed_run_are_that_ones(tmp_path: Path) -> None:
    """As a program of an arm does when it connects. What rig has set besides is put back."""
    bench = Bench()
    before = owned(bench)
    store = left_by_a_killed_run(bench, tmp_path)
    bench.driver.safe_stop()
    bench.servo.put("operating_mode", 3)
    bench.servo.put("position_p_gain", 16)
    restore(bench.another()._link, store)
    assert bench.servo.value("position_p_gain") == 16
    assert owned(bench) == before | {"position_p_gain": 16}


def test_another_servo_is_written_nothing_where_the_end_of_a_run_was_killed(tmp_path: Path) -> None:
    """All but the mode, and what that resets, is back by then."""
    first = Bench()
    store = left_by_a_killed_run(first, tmp_path)
    hold = first.driver._link.hold

    def held(name: str, value: int) -> bool:
        if name == "position_p_gain":
            raise Killed
        return hold(name, value)

    first.driver._link.hold = held  # type: ignore[method-assign]
    with pytest.raises(Killed):
        first.driver.close()
    other = Bench(store=store, registers={"operating_mode": 4})
    before = other.registers()
    with pytest.raises(Fault, match="SERVO_CHANGED"):
        restore(other.driver._link, store)
    assert other.registers() == before and store.is_kept


def test_a_run_puts_back_its_own_values_whatever_the_file_holds_by_then(tmp_path: Path) -> None:
    """Two adapters of one serial number have one file."""
    first, path = Bench(), tmp_path / "servo.json"
    first.servo.put("position_p_gain", 123)
    before = owned(first)
    left_by_a_killed_run(first, tmp_path)
    Bench(store=BeforeStore(path)).armed()
    first.driver.close()
    assert owned(first) == before


def test_what_somebody_has_changed_since_a_killed_run_is_put_back_no_more_once_the_file_says_so(tmp_path: Path) -> None:
    """As the fault says."""
    bench = Bench()
    before = owned(bench) | {"return_delay_time": 10}
    store = left_by_a_killed_run(bench, tmp_path)
    bench.driver.safe_stop()
    bench.servo.put("return_delay_time", 10)
    with pytest.raises(Fault, match="with 10 for 250 there the rest is put back"):
        restore(bench.another()._link, store)
    assert store.path is not None
    store.path.write_text(store.path.read_text().replace('"return_delay_time": 250', '"return_delay_time": 10'))
    restore(bench.another()._link, store)
    assert owned(bench) == before


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_that_lost_its_supply_after_a_killed_run_is_no_other_one(protocol: str, tmp_path: Path) -> None:
    """A Feetech forgets what is behind its lock, a Dynamixel its goals and gains."""
    bench = Bench(protocol)
    before = owned(bench)
    store = left_by_a_killed_run(bench, tmp_path)
    bench.servo.power_cycle()
    bench.bus.sleep_until(bench.bus.now_s() + 0.5)
    bench.store = store
    run_of = bench.another()
    run_of.open()
    run_of.close()
    assert owned(bench) == before | {"torque_limit": 1000} if protocol == "feetech" else before


@pytest.mark.parametrize(("protocol", "mode", "step"), [
    ("dynamixel", "its own", 6), ("feetech", "PWM", 3),
    *evidence(*((p, mode, 1) for p in PROTOCOLS for mode in ("its own", "PWM"))),
])  # fmt: skip
def test_what_a_keeper_that_was_killed_had_still_to_put_back_the_next_command_does(
    protocol: str, mode: str, step: int, tmp_path: Path
) -> None:
    given, orders = 2, 3
    while given < orders:
        bench = Bench(protocol)
        if mode == "PWM":  # and the run's limit: nothing of a run shows
            for role, value in {
                "mode": bench.setup.model.pwm_mode,
                "max_drive": bench.setup.max_units,
                "drive": 0,
            }.items():
                bench.servo._set(role, value)
        bench.servo.put("position_p_gain", 123)  # which a change of the mode resets
        keeper, before = Keeper(bench), owned(bench)
        bench.driver._start_guardian = keeper
        store = left_by_a_killed_run(bench, tmp_path)
        bench.tick(0.3)
        assert keeper.stop()
        keeper._zero = () if mode == "PWM" else keeper._zero  # the servo did not hear that
        orders = len(keeper._restore)
        keeper._restore = keeper._restore[:given]
        assert keeper.restore()
        bench.bus.sleep_until(bench.bus.now_s() + 0.5)
        restore(bench.another()._link, store)
        assert owned(bench) == before and not bench.servo.is_on and not store.is_kept, given
        assert mode != "PWM" or bench.servo.of("drive") == 0, given
        given += step


@pytest.mark.parametrize(("protocol", "first"), [
    *((p, 5) for p in PROTOCOLS), *evidence(*((p, f) for p in PROTOCOLS for f in range(6))),
])  # fmt: skip
def test_facts_that_are_killed_anywhere_are_put_right_by_the_next_run(
    protocol: str, first: int, tmp_path: Path
) -> None:
    """Ahead of every seventh write of a register that a run changes."""
    at, is_there = 7 * first, True
    while is_there:
        bench = Bench(protocol, store=BeforeStore(tmp_path / f"servo-{at}.json"))
        link, before, left = bench.driver._link, owned(bench), at
        real, changed = link.write_of, set(values_of(link))

        def write_of(name: str, value: int, changed: set[str] = changed, real: Callable[[str, int], Ask] = real) -> Ask:
            nonlocal left
            left -= name in changed
            if left < 0:
                raise Killed
            return real(name, value)

        link.write_of = write_of  # type: ignore[method-assign]
        try:
            for _ in facts(link, bench.store, lambda bench=bench: bench.bus.power_cycle()):  # type: ignore[misc]
                pass
        except Killed:
            pass
        else:
            is_there = False
        bench.bus.sleep_until(bench.bus.now_s() + 0.5)
        bench.store = BeforeStore(bench.store.path)
        bench.servo.put("torque_enable", 0)
        bench.another().open()
        bench.driver.close()
        assert owned(bench) == before, at
        at += 42 if first < 5 else 60
