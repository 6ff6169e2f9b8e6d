"""The register map and the link budget: what cannot work is refused at its key, with the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from rig.backends.link_budget import LinkBudget
from rig.backends.modbus.link_budget import longest_transaction_s, transactions
from rig.backends.modbus.section import tcp_address
from rig.backends.registry import backend_of
from rig.backends.tick_waits import UNWATCHED_S
from rig.config import Experiment, load
from rig.running.preflight import notes, preflight
from rig.running.preflight.plan import plan
from rig.running.preflight.room_to_stop import (
    guard_settings_of,
    reaction_periods,
    stopping_rad,
    stopping_terms,
)

CONFIG = Path(__file__).parents[2] / "config" / "modbus-rtu.yaml"
SECTION = "daq.modbus.registers."


def example(registers: dict[str, Any] | None = None, daq: dict[str, Any] | None = None, **modbus: Any) -> Experiment:
    """The RTU example with these changed; None takes out."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["daq"] |= daq or {}
    for section, changes in ((data["daq"]["modbus"], modbus), (data["daq"]["modbus"]["registers"], registers or {})):
        for name, value in changes.items():
            if value is None:
                del section[name]
            else:
                section[name] = value
    return Experiment.model_validate(data)


def link_budget(e: Experiment) -> LinkBudget:
    return backend_of(e.device).budget(e.device)


def reading_budget(e: Experiment) -> LinkBudget:
    return backend_of(e.device).reading_budget(e.device)


def problems(e: Experiment) -> dict[str, str]:
    return {".".join(map(str, problem.path)): problem.message for problem in preflight(e).problems}


def test_the_examples_pass() -> None:
    for name in ("modbus-rtu", "modbus-tcp"):
        data = yaml.safe_load((CONFIG.parent / f"{name}.yaml").read_text(encoding="utf-8"))
        assert not preflight(Experiment.model_validate(data)).problems


@pytest.mark.parametrize(
    ("registers", "modbus", "key", "words"),
    [
        ({"sequence": {"address": 2, "echo": 17}}, {}, "sequence.address", "2 is not beside the drive, register 0"),
        ({"drive": {"address": 0, "type": "int32", "full": 10000}}, {}, "sequence.address", "in the place of drive"),
        ({"status": {"address": 16}}, {}, "status.address", "register 16 lies in the place of position"),
        ({"limits": {"low": 9, "high": 11}}, {}, "limits.low", "register 9 lies in the place of watchdog.address"),
        (
            {
                "limits": {"low": 2, "high": 9},
                "drive": {"address": 1, "type": "int32", "full": 10000},
                "sequence": {"address": 0, "echo": 17},
            },
            {},
            "limits.low",
            "register 2 lies in the place of drive.address, registers 1 and 2",
        ),
        (
            {
                "max_drive": {"address": 10},
                "drive": {"address": 1, "type": "int32", "full": 10000},
                "sequence": {"address": 0, "echo": 17},
            },
            {},
            "max_drive.address",
            "registers 10 and 11 lie in the place of limits.high",
        ),
        (
            {"status": {"address": 150}},
            {},
            "status.address",
            "would read 135 registers, 16 to 150; one request can read 125",
        ),
        ({"position": {"address": 65535, "type": "float32"}}, {}, "position.address", "end beyond the last one, 65535"),
        ({"position": {"address": 16, "table": "input"}}, {}, "position.table", "FC23 reads holding registers only"),
    ],
)
def test_registers_that_cannot_be_asked_together(
    registers: dict[str, Any], modbus: dict[str, Any], key: str, words: str
) -> None:
    assert words in problems(example(registers, **modbus))[SECTION + key]


def test_an_address_of_a_manual_is_told_apart() -> None:
    found = {".".join(map(str, p.path)): p.hint for p in preflight(example({"position": {"address": 40017}})).problems}
    assert "40017 in a manual is holding register 16" in found[SECTION + "sequence.echo"]
    assert "daq.baud" not in found  # the time of a request that cannot be made says nothing
    found = {".".join(map(str, p.path)): p.hint for p in preflight(example({"position": {"address": 30001}})).problems}
    assert "30001 in a manual is input register 0" in found[SECTION + "sequence.echo"]


def test_a_manual_s_address_that_can_be_asked_for_is_a_note() -> None:
    def notes(address: int) -> list[str]:
        drive, sequence = {"address": address, "full": 100}, {"address": address + 1, "echo": 17}
        return [line for line in plan(example({"drive": drive, "sequence": sequence})) if "manual" in line]

    assert notes(40101) == ["note: addresses count from 0: 40101 in a manual is holding register 100"]
    assert notes(100) == notes(50_000) == []


def test_what_a_device_cannot_tell_of_a_pause_is_a_note() -> None:
    def notes_of(registers: dict[str, Any], **modbus: Any) -> list[str]:
        return [note for note in notes(example(registers, **modbus).device) if "in a pause" in note]

    assert notes_of({}) == []
    (note,) = notes_of({"status": None})
    assert "rig does not see an e-stop that you press and release in a pause" in note
    (note,) = notes_of({"status": {"address": 19, "faults": {"DEVICE_WATCHDOG": 2}}})
    assert "names no DEVICE_ESTOP" in note and "while it is open" in note
    settings: dict[str, Any] = dict.fromkeys(("watchdog", "limits", "rails", "max_drive"))
    (note,) = notes_of(settings, device_watchdog_s=0.1)
    assert note.endswith("rig would not notice a power cycle in a pause")
    for name in ("limits", "rails", "max_drive"):
        assert notes_of({key: value for key, value in settings.items() if key != name}, device_watchdog_s=0.1) == []


def test_what_stops_the_device_is_not_what_arms_it() -> None:
    with pytest.raises(ValidationError, match="`arm` and `stop` are both 1"):
        example({"control": {"address": 8, "arm": 1, "stop": 1}})


def test_the_input_table_is_another_place() -> None:
    registers = {"position": {"address": 0, "table": "input"}, "sequence": {"address": 1, "echo": 17}}
    e = example(registers, requests="separate").model_copy(update={"period_s": 0.02})
    assert not any(key.startswith(SECTION) for key in problems(e))


@pytest.mark.parametrize(
    ("daq", "key", "words"),
    [
        ({"timeout_s": 0.011}, "daq.timeout_s", "longer than the period of 0.01 s"),
        ({"timeout_s": 0.005}, "daq.timeout_s", "5 ms is shorter than a transaction, 6.60 ms"),
        ({"port": None}, "daq.port", "needs a port"),
        ({"port": "emulated-chip"}, "daq.port", "no emulated-chip for `driver: modbus`"),
        ({"port": "udp://10.0.0.1"}, "daq.port", "is no address"),
        ({"port": "tcp//10.0.0.1"}, "daq.port", "write tcp://192.168.0.5"),
        ({"port": "tcp://10.0.0.1:99999"}, "daq.port", "out of range"),
        ({"port": "192.168.0.5"}, "daq.port", "an address, not a serial port"),
        ({"port": "192.168.0.5:1502"}, "daq.port", "an address, not a serial port"),
        ({"modbus": None}, "daq.modbus", "needs this section"),
        ({"driver": "serial"}, "daq.modbus", "is a key of `driver: modbus`"),
        ({"adapter": "ftdi"}, "daq.adapter", "is a key of `driver: serial`, not of `driver: modbus`"),
    ],
)
def test_what_else_is_refused(daq: dict[str, Any], key: str, words: str) -> None:
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["daq"] |= daq
    assert words in problems(Experiment.model_validate(data))[key]


def test_a_watchdog_that_its_register_cannot_hold() -> None:
    assert "0.012 units" in problems(example({"watchdog": {"address": 9, "unit_s": 10.0}}))["daq.watchdog_s"]
    with pytest.raises(ValidationError, match="not both"):
        example(device_watchdog_s=0.2)


@pytest.mark.parametrize(
    ("registers", "words"),
    [
        ({"drive": {"address": 0, "type": "uint16", "full": 100}}, "int16"),
        ({"drive": {"address": 0, "full": 40000}}, "from 50 to 32767"),
        ({"drive": {"address": 0, "full": 100.5}}, "whole number"),
        ({"position": {"address": 0, "scale": 0.0}}, "must not be 0"),
        ({"status": {"address": 0, "faults": {"TRAVEL_HARD": 2}}}, "known: DEVICE_"),
        ({"status": {"address": 0, "faults": {"DEVICE_TRAVEL": 1}}}, "1 is armed, not DEVICE_TRAVEL"),
        ({"status": {"address": 0, "faults": {"DEVICE_TRAVEL": 2, "DEVICE_SENSOR": 2}}}, "2 is given to"),
        ({"drive": {"address": 65536, "full": 100}}, "65535"),
    ],
)
def test_a_key_that_cannot_be(registers: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        example(registers)


def test_addresses_of_tcp() -> None:
    assert tcp_address("tcp://192.168.0.5") == ("192.168.0.5", 502)
    assert tcp_address("tcp://plc:1502/") == ("plc", 1502)
    assert tcp_address("tcp://[::1]:5020") == ("::1", 5020)
    for bad in ("tcp://", "tcp://host:0", "tcp://host/path", "http://host", "tcp://host:x"):
        with pytest.raises(ValueError, match=bad):
            tcp_address(bad)


# ---------------------------------------------------------------------- link budget


def test_frames_are_as_long_as_pymodbus_makes_them() -> None:
    for tcp, framer in ((False, FramerRTU(DecodePDU(False))), (True, FramerSocket(DecodePDU(False)))):
        modbus = example().daq.modbus
        assert modbus is not None
        read, written = [0] * 4, [0] * 2  # position, echo, applied, status; drive, sequence
        for requests, pdus in (
            (
                "read-write",
                [
                    (
                        ReadWriteMultipleRegistersRequest(16, 4, 0, written),
                        ReadWriteMultipleRegistersResponse(registers=read),
                    )
                ],
            ),
            (
                "separate",
                [
                    (ReadHoldingRegistersRequest(address=16, count=4), ReadHoldingRegistersResponse(registers=read)),
                    (
                        WriteMultipleRegistersRequest(address=0, registers=written),
                        WriteMultipleRegistersResponse(address=0, count=2),
                    ),
                ],
            ),
        ):
            asked = transactions(modbus.model_copy(update={"requests": requests}), tcp=tcp)
            lengths = [tuple(len(framer.buildFrame(pdu)) for pdu in pair) for pair in pdus]
            assert [(t.request_bytes, t.reply_bytes) for t in asked] == lengths


def test_the_sum_of_rtu() -> None:
    budget = link_budget(example())
    assert dict(budget.terms) == pytest.approx({"wire": 30 * 10 / 115200, "2 silences": 0.0035, "turnaround": 0.0005})
    assert budget.total_s == pytest.approx(0.006604, abs=1e-6)
    strict = link_budget(example(parity="even"))
    assert dict(strict.terms)["wire"] == pytest.approx(30 * 11 / 115200)
    slow = link_budget(example(daq={"baud": 9600}))
    assert dict(slow.terms)["2 silences"] == pytest.approx(2 * 3.5 * 10 / 9600)  # 3.5 characters up to 19200 baud
    assert dict(link_budget(example(silence_s=0.001)).terms)["2 silences"] == pytest.approx(0.002)


def test_a_reading_alone_is_what_the_device_answers_without_being_armed() -> None:
    """One silence only, before the reply; of separate requests the first."""
    reading = reading_budget(example())
    assert dict(reading.terms) == pytest.approx({"wire": 21 * 10 / 115200, "1 silence": 0.00175, "turnaround": 0.0005})
    assert reading.written.startswith("FC03 request 8 + FC03 reply 13 = 21 bytes x 10 bits / 115200 baud = 1.82 ms")
    inputs = example({"position": {"address": 16, "table": "input"}}, requests="separate")
    assert reading_budget(inputs).wire.startswith("FC04 request 8 + FC04 reply 13")
    assert reading_budget(inputs).total_s < link_budget(inputs).total_s
    serial = load(CONFIG.parent / "demo.yaml")
    assert reading_budget(serial).total_s < link_budget(serial).total_s
    assert not reading_budget(load(CONFIG.parent / "quick.yaml")).terms


def test_what_is_too_slow_for_the_period_is_said_once() -> None:
    """No time-out within the period would help."""
    assert set(problems(example(daq={"baud": 9600}))) == {"daq.baud"}


@pytest.mark.parametrize("baud", [9600, 19200, 38400, 57600])
def test_what_does_not_fit_is_refused_and_the_hint_fits(baud: int) -> None:
    e = example(daq={"baud": baud})
    found = next(problem for problem in preflight(e).problems if problem.path == ("daq", "baud"))
    assert f"{baud} baud" in found.message
    assert "80 % of the period is 8.00 ms" in found.message
    assert found.hint.startswith("daq.baud 115200 fits")
    assert "daq.baud" not in problems(example(daq={"baud": 115200}))


def test_two_transactions_do_not_fit_into_10_ms_at_115200_but_over_tcp_they_do() -> None:
    assert "4 silences" in problems(example(requests="separate"))["daq.baud"]
    over_tcp = example(requests="separate", daq={"port": "tcp://10.0.0.7"})
    assert not problems(over_tcp)
    assert "10 Mbit/s" in "\n".join(preflight(over_tcp).lines)
    too_short = over_tcp.model_copy(update={"period_s": 0.001})
    assert "too slow" in problems(too_short)["period_s"]


def test_a_drive_that_goes_out_a_tick_later_counts_one_period_more() -> None:
    at_once, later = example(requests="separate"), example()
    assert reaction_periods(later.device) == reaction_periods(at_once.device) + 1
    more_s = guard_settings_of(later).reaction_s - guard_settings_of(at_once).reaction_s
    assert more_s == pytest.approx(later.period_s)


def test_a_watchdog_that_is_not_there_is_not_counted_and_said_to_be_missing() -> None:
    """Nothing bounds what the shaft does if the host of such a device dies: no sum may look as if it did."""
    with_one = example()
    none = example({"watchdog": None}, daq={"accept_no_watchdog": True})
    assert backend_of(none.device).watchdog(none.device).time_s is None
    v = none.limits.max_speed_rad_s
    # behind a reply that is lost the stop waits until the line is silent: where no watchdog acts meanwhile, that counts
    assert none.daq.modbus is not None
    waits_s = UNWATCHED_S + longest_transaction_s(none.daq, none.daq.modbus)
    less_s = with_one.daq.timeout_s + with_one.daq.watchdog_s - waits_s
    words = [words for words, _ in stopping_terms(with_one.device) if words != "watchdog"]
    assert [words for words, _ in stopping_terms(none.device)] == [
        "lost reply" if word == "reply time-out" else word for word in words
    ]
    guards_s = [guard_settings_of(e).reaction_s for e in (with_one, none)]
    assert guards_s[0] - guards_s[1] == pytest.approx(less_s)
    assert stopping_rad(with_one.device) - stopping_rad(none.device) == pytest.approx(v * less_s)
    found = preflight(none)
    assert found.problems == ()
    (line,) = (line for line in found.lines if line.startswith("stopping"))
    assert "if the host dies nothing bounds it: the device has no watchdog" in line
    assert "late answers: one may be late by 83 ms, or each by a period; more ends the run" in found.lines


def test_a_watchdog_that_is_set_on_the_device_counts_for_the_room_to_stop() -> None:
    fixed = example({"watchdog": None}, device_watchdog_s=0.3)
    more_s = guard_settings_of(fixed).reaction_s - guard_settings_of(example()).reaction_s
    assert more_s == pytest.approx(0.3 - example().daq.watchdog_s)
    text = "\n".join(preflight(fixed).lines)
    assert "sets 0 V after 300 ms of silence, as set on it" in text
    assert "no room to stop" in problems(fixed)["limits.max_speed_rad_s"]


def test_a_device_that_holds_its_last_drive_is_refused_offline() -> None:
    none = example({"watchdog": None})
    assert "nothing sets 0 V when the host is silent" in problems(none)["daq.modbus"]
    accepted = none.model_copy(update={"daq": none.daq.model_copy(update={"accept_no_watchdog": True})})
    assert problems(accepted) == {}
    assert "failsafe: none" in "\n".join(preflight(accepted).lines)


def test_a_relay_in_the_device_is_not_for_modbus() -> None:
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["relay"]["where"] = "device"
    assert "has no relay in the device" in problems(Experiment.model_validate(data))["relay.where"]


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/dev/ttyUSB0", "a REAL MOTOR behind /dev/ttyUSB0, Modbus RTU, unit 1, 115200 baud"),
        ("tcp://10.0.0.7", "a REAL MOTOR behind tcp://10.0.0.7, Modbus TCP, unit 1"),
        ("emulated", "an emulated I/O block, Modbus RTU, unit 1, 115200 baud, virtual time, nothing moves"),
        ("emulated-realtime", "behind a pseudo-terminal, Modbus RTU, unit 1, 115200 baud, real time, nothing moves"),
        ("emulated-tcp", "an emulated I/O block, Modbus TCP, unit 1, virtual time, nothing moves"),
        ("emulated-tcp-realtime", "on a port of this machine, Modbus TCP, unit 1, real time, nothing moves"),
    ],
)
def test_check_says_what_is_behind_the_port(port: str, words: str) -> None:
    assert words in preflight(example(daq={"port": port})).lines[0]


def test_a_word_for_no_device_is_refused_and_the_old_one_for_virtual_time_named() -> None:
    assert "emulated-tcp-realtime" in str(preflight(example(daq={"port": "emulated-udp"})).problems[0])
    (problem,) = preflight(example(daq={"port": "emulated-virtual"})).problems
    assert (problem.key, problem.hint) == ("daq.port", "it is `emulated` now")
