"""The fault matrix, a share of it: the same code and the same bounds as `make faults`, which runs all.

`make test` has one row of each way that a run ends, and one of each device in each stage; `make evidence` all of it.
"""

from __future__ import annotations

import ast
import contextlib
import json
import math
import os
import random
import re
import socket
import warnings
from collections.abc import Hashable
from dataclasses import replace
from pathlib import Path

import pytest
from evidence import evidence, first_of_each

from faults import damage, kept, logged_rig, realtime, worst
from faults.acts import FREEZE_S
from faults.backends import (
    BACKENDS,
    BARE,
    BOARD,
    BOARD_RELAY,
    CHIP,
    CHIP_ENCODER,
    CHIP_RELAY,
    MODBUS,
    PLAIN,
    SEPARATE,
    SERVO,
    SERVO_FEETECH,
    TCP,
    Backend,
)
from faults.bounds import Times, bound
from faults.case import Found, measure, new_injector, restart, times, undisturbed
from faults.kept import Line
from faults.language import ModbusLanguage, Reading, SerialLanguage, is_drive
from faults.matrix import is_alike, phase_at, phases_of, stages_of
from faults.page import at_worst, cells, render_rows, render_summary, summary
from faults.realtime import DEVICES, REAL_ROWS
from faults.rows import ROWS, Row
from faults.stages import ARMING, BY_KEY, CYCLE, OTHER_STAGES, PAUSE, REST, START, Stage
from rig.backends.modbus.emulated.rtu_slave import frame
from rig.backends.modbus.emulated.tcp_slave import Adu
from rig.backends.serial.frames import Block, DeviceState, Kind, RelaySetup, encode, pack_drive
from rig.control.guard import Guard

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
SUMMARY = ROOT / "docs" / "evidence" / "fault-table.md"
PAGE = ROOT / "docs" / "evidence" / "fault-rows.md"


LINKS = (CHIP_RELAY, BOARD_RELAY, SEPARATE, TCP, BARE)  # the others differ in board, sensor or test: `make faults`


def share() -> list[tuple[Row, Backend]]:
    """Of the other devices the rows that are theirs or other there; each of the rest on one of them, in turn."""
    own = {CHIP_RELAY: "relay", SEPARATE: "separate", TCP: "tcp", BARE: "bare"}
    cases = [(row, backend) for row in ROWS for backend, trait in own.items() if trait in (*row.only, *row.other)]
    plain = [row for row in ROWS if not any(trait in (*row.only, *row.other) for trait in own.values())]
    cases += [(row, LINKS[k % len(LINKS)]) for k, row in enumerate(plain) if not is_alike(row)]
    cases += [(row, CHIP_ENCODER) for row in ROWS if row.only == ("encoder",)]
    cases += [(row, SERVO) for row in ROWS]
    cases += [(row, SERVO_FEETECH) for row in ROWS if "feetech" in row.other]
    return [(row, backend) for row, backend in cases if _cycle_or_start(row, backend)]


def _cycle_or_start(row: Row, backend: Backend) -> bool:
    """Whether a row is tried in the breakaway check or the relay test."""
    return any(stage in (START, CYCLE) for stage in stages_of(row, backend))


def of_plain() -> list[tuple[Row, Backend]]:
    """All rows on the board; on the chip and on the I/O block those that are other there, the rest in turn."""
    cases = [(row, BOARD) for row in ROWS if row.is_for(BOARD.traits)]
    others = [backend for backend in PLAIN if backend is not BOARD]
    for k, row in enumerate(row for row in ROWS if not is_alike(row)):
        for backend in others:
            is_own = any(trait in (*row.only, *row.other) for trait in backend.traits) or not row.is_for(BOARD.traits)
            if row.is_for(backend.traits) and (is_own or others[k % len(others)] is backend):
                cases.append((row, backend))
    return cases


CASES = of_plain() + share()


def staged() -> list[tuple[Row, Backend, Stage]]:
    """Each row in one of the other stages, in turn; and wherever else a device may be disarmed and armed again."""
    cases = []
    for k, row in enumerate(row for row in ROWS if row.only != ("encoder",)):
        places = [
            (backend, stage) for backend in BACKENDS for stage in stages_of(row, backend) if stage in OTHER_STAGES
        ]
        mine = [place for place in places if place[0] is BOARD] or places
        chosen = [mine[k % len(mine)]] if mine else []
        if row.name in PAUSED:
            chosen += [place for place in places if place[1] in (PAUSE, ARMING)]
        if row.name in BARELY:
            chosen += [place for place in places if place[0] is BARE]
        cases += [(row, *place) for place in dict.fromkeys(chosen)]
    return cases


PAUSED = (
    "cable out", "device reset", "brown-out", "sensor at a rail, for a moment", "e-stop", "e-stop, for a moment",
    "both end switches, for a moment", "host SIGINT", "recorder killed",
)  # fmt: skip
BARELY = ("pushed over a limit",)


def one_phase(name: str, backend: Backend, stage: Stage) -> float:
    """One of the phases of `make faults`: what is measured there is in docs/evidence/fault-worst.json, too."""
    phases = phases_of(backend, stage)
    return phase_at(random.Random(f"{name} {backend.key} {stage.key}").randrange(phases), phases)


def warn(found: Found) -> None:
    """Say in the test's output where it took longer than it ever did."""
    for words in worst.longer([found], worst.recorded()):
        warnings.warn(worst.Longer(words), stacklevel=2)


# what `make test` takes of a class: its undisturbed run is the cheapest
CHEAP_FIRST = sorted(CASES, key=lambda case: case[1] in (CHIP_RELAY, SEPARATE, TCP))
BOARD_FIRST = sorted(staged(), key=lambda case: case[1] is not BOARD)


def _id(value: Row | Backend | Stage) -> str:
    return value.name if isinstance(value, Row) else value.key


def _ends_alike(case: tuple[Row, Backend]) -> Hashable:
    """On the board, how a run ends; one more of each other driver, and of a device whose only limits are the guard's.

    The firmware on a chip is at the pin in tests/hil: encoder, relay in the device, silence of the host.
    """
    row, backend = case
    if backend in (CHIP, CHIP_ENCODER, CHIP_RELAY, BOARD_RELAY):  # the board's driver
        row, backend = CASES[0]
    if backend is BOARD:
        return row.codes, row.early
    return (MODBUS if backend in (SEPARATE, TCP) else backend).key


def _place(case: tuple[Row, Backend, Stage]) -> str:
    """The stage, on the board. In a pause on other devices: tests/experiment/test_experiment_pause.py."""
    return case[2].key


@pytest.mark.filterwarnings("default::faults.worst.Longer")
@pytest.mark.parametrize(("row", "backend"), first_of_each(CHEAP_FIRST, _ends_alike), ids=_id)
def test_every_fault_ends_within_its_bound_with_its_code_and_no_sample_lost(row: Row, backend: Backend) -> None:
    found = measure(row, backend, one_phase(row.name, backend, START if row.early else CYCLE))
    assert found.trouble == ()
    assert (
        found.off_s <= found.bound_s
        and found.lost <= row.on((START if row.early else CYCLE).traits(backend.traits)).may_lose
    )
    warn(found)


@pytest.mark.filterwarnings("default::faults.worst.Longer")
@pytest.mark.parametrize(("row", "backend", "stage"), first_of_each(BOARD_FIRST, _place), ids=_id)
def test_every_fault_in_the_other_stages(row: Row, backend: Backend, stage: Stage) -> None:
    found = measure(row, backend, one_phase(row.name, backend, stage), stage)
    assert found.trouble == ()
    assert found.off_s <= found.bound_s
    warn(found)


def test_each_place_has_one_code_or_two_with_a_reason_and_a_bound_from_the_config() -> None:
    for backend in BACKENDS:
        for row in ROWS:
            for stage in stages_of(row, backend):
                here = row.on(stage.traits(backend.traits))
                most = 3 if row.name == "sensor noisy" else 2  # which rule its noise breaks first is chance
                assert 1 <= len(here.codes) <= most, (row.name, backend.key, stage.key)
                assert len(here.codes) == 1 or here.either, (row.name, backend.key, stage.key)
                assert math.isfinite(here.bound.seconds(KNOWN)), (row.name, backend.key, stage.key)


# every time but those that a device may not have
KNOWN = Times(**dict.fromkeys(Times._fields, 1.0))


def test_each_row_is_tried_in_each_stage_or_the_page_says_why_not() -> None:
    for row in ROWS:
        tried = {stage for backend in BACKENDS for stage in stages_of(row, backend)}
        if row.early:
            assert tried == {START}
        elif row.only in (("relay",), ("servo",)):
            assert tried == {CYCLE}
        elif "tcp" in row.only:
            assert tried == {CYCLE, PAUSE, ARMING}
        else:
            assert tried | {BY_KEY[key] for key in row.absent if key in BY_KEY} == {CYCLE, *OTHER_STAGES}, row.name


@pytest.mark.parametrize(
    "name", ["port gone", *evidence("drive reversed", "device reset", "sensor wire broken", "host SIGKILL")]
)
def test_the_next_run_is_refused_while_the_cause_is_there_and_moves_after(name: str) -> None:
    row = next(row for row in ROWS if row.name == name)
    found = measure(row, BOARD, 0.3, restarts=True)
    assert found.trouble == () and found.restart.endswith("moves")
    assert found.restart.startswith("refused") == row.lasting


@pytest.mark.parametrize(
    ("name", "cause", "backend"),
    [
        ("brown-out", "brown-out", BOARD),
        ("firmware hang", "watchdog", BOARD),
        *evidence(("brown-out", "brown-out", CHIP), ("firmware hang", "watchdog", CHIP)),
    ],
    ids=lambda value: value.key if isinstance(value, Backend) else value,
)
def test_the_next_run_says_why_the_device_was_reset(name: str, cause: str, backend: Backend, tmp_path: Path) -> None:
    row = next(row for row in ROWS if row.name == name)
    injector, experiment = new_injector(backend, backend.config(), tmp_path, 1)
    injector.watch(0.1)
    row.act(injector)
    injector.watch(0.3)
    assert restart(injector, backend, experiment) == ""
    meta = json.loads(next((tmp_path / "runs").glob("*/meta.json")).read_text(encoding="utf-8"))
    assert meta["firmware"]["reset_cause"] == cause


@pytest.mark.evidence  # in virtual time it is a row on the board; in real time make test has test_faults_kill.py
@pytest.mark.realtime
@pytest.mark.parametrize("name", ["host SIGSTOP, 1 s"])
def test_a_process_that_is_stopped_in_real_time(name: str) -> None:
    """The bound is longer by what this machine was late in this run, device and loop."""
    row = next(row for row in REAL_ROWS if row.name == name)
    found = realtime.measure(row, DEVICES[0], 0.6)
    assert found.trouble == ()
    assert found.off_s <= found.bound_s and found.lost == 0


def test_every_fault_that_was_asked_for_is_there() -> None:
    """The list of the issue, as rows."""
    names = " | ".join(row.name for row in ROWS)
    for asked in (
        "cable out", "port gone", "garbage", "bit flips", "truncated", "duplicated", "late", "lost", "reordered",
        "stale", "device reset", "firmware hang", "brown-out", "sensor at a rail", "wire broken", "sensor stuck",
        "sensor jumps", "sensor noisy", "drive stuck on", "drive reversed", "drive dead", "friction too high to start",
        "limit hit at speed", "end switch", "e-stop", "SIGINT", "SIGTERM", "SIGKILL", "SIGSTOP, 1 s",
        "host overloaded", "clock stepped", "disk full", "folder unwritable", "recorder killed", "config changed",
    ):  # fmt: skip
        assert asked in names
    assert FREEZE_S == 1.0


# ---------------------------------------------------------------------- that the matrix would notice


def test_a_bound_that_is_too_tight_and_a_code_that_is_another_are_found() -> None:
    row = next(row for row in ROWS if row.name == "cable out")
    wrong = replace(row, bound=bound("too tight", period=1), codes=("LINK_LOST",))
    found = measure(wrong, BOARD, 0.5)
    assert any("drive on for" in words for words in found.trouble)
    assert any("LINK_TIMEOUT" in words for words in found.trouble)
    told = cells(wrong, Line(wrong, BOARD, CYCLE, times(BOARD, "relay"), (found,)).kept("today", ""))
    assert "**broken**" in told[1] and told[4] == "LINK_TIMEOUT, 1"


def test_a_sample_that_the_record_has_not_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from rig.run_folder.recording import sink
    from rig.run_folder.recording.recorder import Recorder

    original = Recorder.sample

    def forgetful(self: Recorder, *row: *sink.Row) -> None:
        original(self, *row)
        if row[0] % 50 == 7:
            self._opened -= 1  # the next row takes its place

    undisturbed(BOARD, "relay")
    monkeypatch.setattr(Recorder, "sample", forgetful)
    found = measure(next(row for row in ROWS if row.name == "host SIGTERM"), BOARD, 0.5)
    assert found.lost > 5
    assert any("samples lost" in words for words in found.trouble)


@pytest.mark.parametrize("device", [d for d in DEVICES if d.key in ("board", "tcp")], ids=lambda d: d.key)
@pytest.mark.parametrize("lost", [(), (60,), (60, 61, 62)], ids=len)
@pytest.mark.parametrize("in_pause", [0, 5])
def test_a_pause_of_any_length_neither_looks_like_lost_samples_nor_hides_them(
    device: realtime.RealDevice, lost: tuple[int, ...], in_pause: int
) -> None:
    """In real time. Of Modbus the readings in a pause are counted in the rows, and not in what the host was told."""
    more = in_pause if device.key == "tcp" else 0
    first = 51 + device.between
    rows = [{"stage": "breakaway", "seq": str(k)} for k in range(1, 51)]
    rows += [{"stage": "relay-1", "seq": str(k + more)} for k in range(first, 101) if k not in lost]
    told = list(range(1, 101))
    keys = realtime._keys(device, rows)
    assert realtime._lost(told, 1, keys, None, killed=False) - device.between == len(lost)


@pytest.mark.parametrize(
    ("told", "keys", "lost"),
    [
        ([1, 3, 5, 7, 8], [1, 3, 5], 0),  # a host that stood still asked again, and the second answer has the fault
        ([1, 3, 5, 7, 8], [1, 3], 1),
        ([1, 3, 5, 7], [1, 5, 7], 1),
    ],
)
def test_a_reading_that_was_asked_for_again_is_counted_once(told: list[int], keys: list[int], lost: int) -> None:
    fault = {"code": "DEVICE_WATCHDOG", "detail": "code 5 (watchdog) at 0.1 rad, 540 counts"}
    assert realtime._lost(told, 2, keys, fault, killed=False) == lost


@pytest.mark.evidence
@pytest.mark.parametrize("stage", [REST, ARMING], ids=_id)
def test_a_guard_whose_travel_rule_does_nothing_is_found(monkeypatch: pytest.MonkeyPatch, stage: Stage) -> None:
    """On a device without limits of its own nobody else would stop a shaft that is pushed slowly over one.

    But where the relay drives inward meanwhile: that the shaft heeds no drive is another rule's, so it is off, too.
    """
    undisturbed(BARE, "relay"), undisturbed(BARE, stage.course)
    monkeypatch.setattr(Guard, "_check_polarity", lambda *_: None)
    monkeypatch.setattr(Guard, "_limit_travel", lambda self, sample, asked_V: (asked_V, 0))
    row = next(row for row in ROWS if row.name == "pushed over a limit")
    assert measure(row, BARE, one_phase(row.name, BARE, stage), stage).trouble != ()


def test_what_takes_longer_than_ever_is_said(tmp_path: Path) -> None:
    found = Found("port gone", BOARD.key, CYCLE.key, 0.5, 0.04, 0.05, 0.0, "LINK_LOST", 1, 0)
    place = tmp_path / "worst.json"
    assert worst.recorded(place) == {}
    worst.write([replace(found, off_s=0.02), replace(found, off_s=0.05)], {}, place)
    before_s = worst.recorded(place)
    assert before_s == {"port gone | board | cycle": 0.05}
    assert worst.longer([replace(found, off_s=0.07)], before_s) == []
    slow = replace(found, off_s=0.08)
    assert worst.longer([slow], before_s) == [
        "port gone | board | cycle: drive on for 80.0 ms; recorded are 50.0 ms at most"
    ]
    worst.write([slow], before_s, place)
    assert worst.recorded(place) == before_s  # until somebody accepts it
    assert worst.longer([replace(found, off_s=0.0005)], {"port gone | board | cycle": 0.0}) == []  # less than a tick


def test_a_record_that_is_another_is_found() -> None:
    row = next(row for row in ROWS if row.name == "replies late")
    found = measure(replace(row, same=True), BOARD, 0.5)
    assert "the recording differs" in found.trouble


def test_what_is_needed_of_the_wire_is_read_off_it() -> None:
    serial, modbus = SerialLanguage(0.03), ModbusLanguage(0.0012)
    drive = encode(Kind.DRIVE, 7, pack_drive(-50))
    assert serial.drive_V(drive) == -1.5 and serial.drive_V(encode(Kind.STOP, 8)) == 0.0
    assert serial.asked(encode(Kind.READ, 9)) == 9 and serial.asked(drive) is None
    state = encode(Kind.STATE, 9, DeviceState(1, 512, 0, 2, 3, 4, 1, 0, 5).pack())
    assert serial.replies(state[:5]) == [] and serial.replies(state[5:] + b"\1") == [state]
    assert serial.readings(state) == [Reading(9, 512, state)]
    assert serial.readings(bytes((state[0], state[1] ^ 1)) + state[2:]) == []

    request = frame(1, bytes((23, 0, 16, 0, 4, 0, 0, 0, 2, 4)) + (-500).to_bytes(2, "big", signed=True) + b"\0\5")
    assert modbus.drive_V(request) == -0.6 and modbus.asked(request) == 1
    assert modbus.is_stop(frame(1, bytes((6, 0, 8, 0, 0)))) and not modbus.is_stop(frame(1, bytes((6, 0, 8, 0, 1))))
    reply = frame(1, bytes((23, 8, 2, 0, 0, 5, 0, 0, 0, 1)))
    assert modbus.readings(reply) == [Reading(1, 512, reply)]
    assert modbus.readings(frame(1, bytes((23, 8, 2, 0, 0, 4, 0, 0, 0, 1)))) == []  # to another drive


def test_what_a_relay_in_the_device_tells_is_read_off_the_wire_up_to_a_gap() -> None:
    serial = SerialLanguage(0.03)

    def block(number: int) -> bytes:
        return encode(Kind.BLOCK, number, Block(0, 1000, 200, 10, 0, 5, ((500, 15), (501, 15))).pack())

    assert serial.drive_V(encode(Kind.KEEP, 3)) is not None and math.isnan(serial.drive_V(encode(Kind.KEEP, 3)) or 0.0)
    start = encode(Kind.RELAY, 2, RelaySetup((1, 1, -1, -1), 8192, 99, 1, 10).pack())
    assert serial.hands_over(start) and not serial.hands_over(encode(Kind.KEEP, 3))
    serial.drive_V(start)
    assert serial.readings(block(0)) == [Reading(0, 500, block(0), 0), Reading(0, 501, block(0), 1)]
    assert serial.readings(block(0)) == [] and len(serial.readings(block(1))) == 2
    assert serial.readings(block(3)) == serial.readings(block(2)) == serial.readings(block(4)) == []
    serial.drive_V(start)
    assert len(serial.readings(block(0))) == 2


def test_separate_requests_count_readings_of_a_tick_only() -> None:
    modbus = ModbusLanguage(0.0012, separate=True)
    read, arm, stop = (frame(1, bytes(pdu)) for pdu in ((3, 0, 16, 0, 4), (6, 0, 8, 0, 1), (6, 0, 8, 0, 0)))
    write = frame(1, bytes((16, 0, 0, 0, 2, 4)) + (750).to_bytes(2, "big") + b"\0\5")
    assert modbus.asked(read) is None  # before it is armed
    assert modbus.asked(arm) is None and modbus.asked(read) is None  # whether it is
    assert modbus.asked(read) == 1 and modbus.asked(write) is None and modbus.asked(read) == 2
    assert (
        modbus.drive_V(write) == pytest.approx(0.9)
        and modbus.drive_V(stop) == 0.0
        and is_drive(write)
        and not is_drive(read)
    )
    reply = frame(1, bytes((3, 8, 2, 0, 0, 5, 2, 238, 0, 1)))
    assert modbus.readings(reply) == [Reading(2, 512, reply)]
    assert modbus.asked(stop) is None and modbus.asked(read) is None


def test_replies_of_a_tcp_stream_are_taken_apart() -> None:
    modbus = ModbusLanguage(0.0012, tcp=True)
    request = Adu(1, 1, bytes((23, 0, 16, 0, 4, 0, 0, 0, 2, 4)) + (-500).to_bytes(2, "big", signed=True) + b"\0\5")
    assert modbus.asked(request.pack()) == 1 and modbus.drive_V(request.pack()) == -0.6
    one = Adu(1, 1, bytes((23, 8, 2, 0, 0, 5, 0, 0, 0, 1))).pack()
    assert modbus.replies(one + one[:9]) == [one] and modbus.replies(one[9:]) == [one]
    assert modbus.readings(one) == [Reading(1, 512, one)] and modbus.readings(one[:-1]) == []


def test_damage_is_what_it_says() -> None:
    rng, sent = random.Random(1), b"abcdefgh"
    (_, flipped), (_, cut) = damage.flipped(sent, rng)[0], damage.truncated(sent, rng)[0]
    assert sum((a ^ b).bit_count() for a, b in zip(sent, flipped, strict=True)) == 1
    assert 0 < len(cut) < len(sent) and sent.startswith(cut)
    assert damage.lost(sent, rng) == [] and damage.duplicated(sent, rng) == [(0.0, sent)] * 2
    swapping, old, first = damage.reordered(), damage.stale(), damage.first(1, damage.lost)
    assert [swapping(piece, rng) for piece in (b"a", b"b")] == [[], [(0.0, b"b"), (0.0, b"a")]]
    assert [old(piece, rng) for piece in (b"a", b"b", b"c")] == [[], [(0.0, b"a")], [(0.0, b"b")]]
    assert [first(piece, rng) for piece in (b"a", b"b")] == [[], [(0.0, b"b")]]


def test_what_a_host_was_told_in_real_time_is_counted() -> None:
    rtu, tcp = {device.key: device.told for device in DEVICES}["modbus"], DEVICES[3].told
    reply = bytes((23, 8, 2, 0, 0, 5, 0, 0, 0, 1))
    log = frame(1, bytes((3, 2, 1, 23))) + frame(1, reply) + frame(1, reply)[:-1] + b"\0" + frame(1, reply)
    assert rtu(log) == [1, 2]  # the one between is damaged
    assert tcp(Adu(1, 1, bytes((3, 2, 1, 23))).pack() + 2 * Adu(2, 1, reply).pack()) == [1, 2]
    assert DEVICES[0].told(encode(Kind.STATE, 9, DeviceState(1, 512, 0, 2, 3, 4, 1, 0, 5).pack())) == [9]


def test_a_dead_terminal_and_a_dead_connection_are_dead(tmp_path: Path) -> None:
    terminal, connection = logged_rig.hung_up_terminal(), logged_rig.reset_connection()
    with contextlib.closing(socket.socket(fileno=connection)) as dead, pytest.raises(ConnectionResetError):
        dead.recv(1)
    assert os.read(terminal, 1) == b""  # its end
    with pytest.raises(OSError):
        os.write(terminal, b"a")
    os.close(terminal)
    link_fault = logged_rig.LinkFault(0, tmp_path / "link-fault")
    assert not link_fault.is_cut(0, lambda: 0)
    realtime.say("cut")(realtime.Case(None, None, tmp_path / "link-fault"))  # type: ignore[arg-type]  # acts on neither
    assert link_fault.is_cut(0, lambda: 0)


# ---------------------------------------------------------------------- clocks


def test_nothing_that_drives_or_records_looks_at_a_clock_that_can_be_set() -> None:
    """CLOCK_MONOTONIC cannot be stepped; the wall clock only names the run."""
    rooms = [ROOT / "rig" / name for name in ("control", "model", "run_folder/recording")]
    looked = 0
    for path in (path for room in rooms for path in room.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "time":
                looked += 1
                assert node.attr in ("monotonic", "sleep", "monotonic_ns", "perf_counter"), f"{path}: time.{node.attr}"
            assert not (isinstance(node, ast.Attribute) and node.attr in ("now", "utcnow", "today")), path
    assert looked > 10
    for source in (ROOT / "firmware").rglob("*.c"):
        assert "CLOCK_REALTIME" not in source.read_text(encoding="utf-8"), source


# ---------------------------------------------------------------------- the page


def test_the_page_has_every_row_on_every_device_with_a_number_and_none_broken() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for backend in BACKENDS:
        section = page.split(f"## On {backend.title}\n")[1].split("\n## ")[0]
        lines = {
            entry[1].strip(): entry for entry in (text.split("|") for text in section.splitlines()) if len(entry) > 7
        }
        for row in ROWS:
            if why := row.why_absent(backend.traits):
                assert f"* {row.name}: does not apply: {why}." in section
            if not _cycle_or_start(row, backend):
                assert row.name not in lines
                continue
            entry = lines[row.name]
            assert re.search(r"\d", entry[2]) and re.search(r"\d", entry[3]), entry
            stage = START if row.early else CYCLE
            most = row.on(stage.traits(backend.traits)).may_lose * phases_of(backend, stage)
            assert int(entry[6]) <= most, entry
            assert entry[7].strip().endswith("moves"), entry
    stages = page.split("## In the other stages\n")[1].split("\n## ")[0]
    for backend in BACKENDS:
        title = f"### {backend.title[0].upper()}{backend.title[1:]}, by stage\n"
        table = stages.split(title)[1].split("\n### ")[0] if title in stages else ""
        for row in ROWS:
            tried = [stage for stage in stages_of(row, backend) if stage in OTHER_STAGES]
            lines_of_row = [text.split("|") for text in table.splitlines() if text.startswith(f"| {row.name} |")]
            assert len(lines_of_row) == bool(tried), (row.name, backend.key)
            if tried:
                assert len([cell for cell in lines_of_row[0][2:-1] if cell.strip()]) == len(tried), lines_of_row
    recorded = set(worst.recorded())
    for backend in BACKENDS:
        for row in ROWS:
            for stage in stages_of(row, backend):
                assert f"{row.name} | {backend.key} | {stage.key}" in recorded
    real = page.split("## Host and link in real time\n")[1].split("\n## ")[0]
    for real_row in REAL_ROWS:
        for device in DEVICES:
            assert (f"| {real_row.name} | {device.key} |" in real) == real_row.is_for(device)
    summed_up = SUMMARY.read_text(encoding="utf-8")
    assert all(f"| {row.name} |" in summed_up for row in ROWS)
    assert all(f"| {backend.title} |" in summed_up for backend in BACKENDS)
    assert "**broken**" not in page + summed_up


def test_the_page_is_what_the_command_writes() -> None:
    row = next(row for row in ROWS if row.name == "port gone")
    bound_s = row.on(CYCLE.traits(BOARD.traits)).bound.seconds(times(BOARD, "relay"))
    next_run = "refused: LINK_LOST; mended: moves"
    found = Found(row.name, BOARD.key, CYCLE.key, 0.1, 0.03, bound_s, 0.0, "LINK_LOST", 1, 0, next_run)
    one = Line(row, BOARD, CYCLE, times(BOARD, "relay"), (found,))
    lines = kept.NONE.with_measured([one], "today", "c0de")
    page, short = render_rows(lines, [row], [BOARD]), render_summary(lines, [row], [BOARD])
    for text in ("## On the host-board device", "| port gone |", "refused: LINK_LOST; mended: moves", "2 tick"):
        assert text in page
    silent_s, within_s = one.found[0].off_s, one.found[0].bound_s
    assert f"| {BOARD.title} | 1 | 1 | {1e3 * silent_s:.1f} ms | {1e3 * within_s:.1f} ms | port gone, " in short
    assert f"| port gone | LINK_LOST | {1e3 * silent_s:.1f} ms | {1e3 * within_s:.1f} ms | {BOARD.title} |" in short
    wrong = replace(one, found=(replace(one.found[0], lost=3, trouble=("3 samples lost",)),))
    assert summary(lines.with_measured([wrong], "today", ""), [row], [BOARD]).endswith("% | 3 | 1 |")
    old = replace(lines, untold={BOARD.key: 1})  # of a run that kept no lines
    assert summary(old.with_measured([one], "today", ""), [row], [BOARD]).endswith("% | 0 | 1 |")
    assert summary(old.with_measured([one], "today", "c0de"), [row], [BOARD]).endswith("% | 0 | 0 |")
    head = next(text for text in page.splitlines() if text.startswith("| fault | drive 0"))
    assert head in PAGE.read_text(encoding="utf-8")
    assert at_worst(lines, [row], [BOARD]).splitlines()[0] in SUMMARY.read_text(encoding="utf-8")


def test_a_part_takes_the_place_of_its_lines_and_the_others_stay(tmp_path: Path) -> None:
    """Also through the file, and the pages in docs are what the kept lines give."""
    lines = kept.read()
    row = next(row for row in ROWS if row.name == "cable out")
    found = Found(row.name, BOARD.key, CYCLE.key, 0.1, 0.05, 0.1, 0.0, "LINK_LOST", 1, 0, "moves")
    part = lines.with_measured([Line(row, BOARD, CYCLE, KNOWN, (found,))], "today", "c0de")
    kept.write(part, tmp_path / "lines.json")
    again = kept.read(tmp_path / "lines.json")
    assert again.lines == dict(part.lines) and again.real == part.real
    key = (row.name, BOARD.key, CYCLE.key)
    assert again.lines[key].shown == ("LINK_LOST, 1",) and again.lines[key].code == "c0de"
    others = {name: line for name, line in again.lines.items() if name != key}
    assert others == {name: line for name, line in lines.lines.items() if name != key}
    worst.write([found], {}, tmp_path / "worst.json")
    worst.write([replace(found, row="port gone")], {}, tmp_path / "worst.json", others=True)
    assert len(worst.recorded(tmp_path / "worst.json")) == 2
    assert render_summary(lines, ROWS, BACKENDS) == SUMMARY.read_text(encoding="utf-8")
    assert render_rows(lines, ROWS, BACKENDS) == PAGE.read_text(encoding="utf-8")


def test_rows_in_real_time_take_the_place_of_their_own_in_the_order_of_the_matrix() -> None:
    """`faults --real --keep`; what is no row any more goes."""
    places = [("cable out", "board"), ("cable out", "chip"), ("port gone", "board")]
    old = replace(kept.NONE, real=[["port gone", "board", "1 ms"], ["gone for good", "board", "2 ms"]])
    new = old.with_real([("cable out", "chip", "3 ms")], places)
    assert [tuple(cells) for cells in new.real] == [("cable out", "chip", "3 ms"), ("port gone", "board", "1 ms")]
    again = new.with_real([("port gone", "board", "4 ms")], places)
    assert [cells[2] for cells in again.real] == ["3 ms", "4 ms"]


def test_an_injector_is_the_device_where_nothing_is_done_to_it(tmp_path: Path) -> None:
    injector, experiment = new_injector(BOARD, BOARD.config(), tmp_path, 1)
    bare = BOARD.device(experiment)
    for port in (injector, bare):
        port.write(encode(Kind.HELLO, 3))
    assert injector.read(0.1) == b"".join(iter(lambda: bare.read(0.01), b""))
    assert injector.read(0.01) == b"" and injector.now_s() > 0.01
