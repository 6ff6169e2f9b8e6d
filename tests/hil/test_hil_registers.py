"""The Uno's registers against the chip's data sheet: what both emulators know of it, and that a breach of it shows.

A defect is put into a copy of the sources, which is built; the table of the rules: docs/evidence/registers-uno.md.
"""

from __future__ import annotations

import itertools
import random
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from chip_host import HELD, QUIET, SETUP, ChipHost, armed_chip
from evidence import evidence
from firmware_copy import copied_firmware
from register_table import check_rules, kept_by, rules
from second_chip import SecondChip, SecondHost

from emulated_chips import build as chip_build
from emulated_chips.build import ChipFirmware
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import Code

pytestmark = pytest.mark.long

BRIDGES = [Variant(), Variant(bridge="IN1_IN2")]
EVERYTHING = Variant("IN1_IN2", 1_000_000, tachometer=True, supply=True, end_switches=True)
UNIT_V = 12.0 / 400
UNIT_S = 2 / 16e6  # of a pulse, for each unit of drive
CYCLE_S = 1 / 16e6
DRIVES = [1, -1, 0, 3, 0, -60, 60, 2, 0, 200, -200, 0, 5, -5]

BRIDGE = firmware_build.source_folder() / "boards" / "uno" / "bridge.c"
AS_IT_WAS = (Path(__file__).parent / "bridge_as_it_was.c").read_text()
MODE_FIRST = (
    "    TCCR1B = PWM;\n    *compare = size; /* now its buffer, which comes into force with the next period */\n"
)
DEFECTS: dict[str, tuple[str, str, str]] = {
    "as it was": ("bridge.c", BRIDGE.read_text(), AS_IT_WAS),
    "as it was, with the mode before ICR1": (
        "bridge.c",
        BRIDGE.read_text(),
        AS_IT_WAS.replace("    ICR1 = BRIDGE_FULL;\n", "").replace("top ICR1, no", "*/ ICR1 = BRIDGE_FULL; /* no"),
    ),
    "the clock before the pin": (
        "bridge.c",
        "    TCCR1A = output;\n    TCCR1B = (uint8_t)(PWM | RUNS);",
        "    TCCR1B = (uint8_t)(PWM | RUNS);\n    TCCR1A = output;",
    ),
    "TCNT1 in PWM": ("bridge.c", "    *compare = size; /* now", "    TCNT1 = 0;\n    *compare = size; /* now"),
    "begun anywhere": ("bridge.c", "    TCNT1 = 0;\n", ""),
    "ICR1 before the mode": (
        "bridge.c",
        MODE_FIRST + "    ICR1 = BRIDGE_FULL;\n",
        "    ICR1 = BRIDGE_FULL;\n" + MODE_FIRST,
    ),
    "the buffer alone": ("bridge.c", "    *compare = size; /* in normal mode: in force at once */\n", ""),
    "not the buffer": (
        "bridge.c", "    *compare = size; /* now its buffer, which comes into force with the next period */\n", ""
    ),
    "the low byte first": (
        "bridge.c", "ICR1 = BRIDGE_FULL;", "ICR1L = BRIDGE_FULL & 0xFFu;\n    ICR1H = BRIDGE_FULL >> 8;"
    ),
    "ICR1 while it counts": ("bridge.c", "TCCR1B = PWM;", "TCCR1B = PWM | RUNS;"),
    "interrupts on in a drive": (
        "main.c",
        "    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)\n    {\n        bridge_drive(",
        "    {\n        bridge_drive(",
    ),
    "the LED and its neighbour": ("main.c", "clear_bits(&PORTB, PIN_LED);", "clear_bits(&PORTB, PIN_LED | BIT(PB4));"),
    "ADMUX in a conversion": (
        "adc.c",
        "    ADMUX = (uint8_t)(REFERENCE | channel_of(which));\n    started = clock_now();\n"
        "    ADCSRA = (uint8_t)(IDLE | BIT(ADSC));\n",
        "    started = clock_now();\n    ADCSRA = (uint8_t)(IDLE | BIT(ADSC));\n"
        "    ADMUX = (uint8_t)(REFERENCE | channel_of(which));\n",
    ),
    "a fast converter": ("adc.c", "BIT(ADPS2) | BIT(ADPS1) | BIT(ADPS0)", "BIT(ADPS2) | BIT(ADPS1)"),
    "error flags written": ("uart.c", "UCSR0A = BIT(U2X0);", "UCSR0A = (uint8_t)(BIT(U2X0) | BIT(FE0));"),
    "baud rate of a port that is on": ("uart.c", "    UCSR0B = 0;", "    "),
    "power-down": ("main.c", "SMCR = 0;", "SMCR = BIT(SM1);"),
    "watchdog without its sequence": (
        "main.c", "wdt_enable(WDTO_120MS);", "WDTCSR = BIT(WDE) | BIT(WDP1) | BIT(WDP0);"
    ),
    "watchdog's flag left": ("main.c", "    MCUSR = 0;\n", ""),
}  # fmt: skip


@pytest.fixture
def build_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, Variant], None]]:
    """Builds the firmware with a defect, by name; from then on every chip runs it."""
    real = chip_build.build_chip()

    def build(name: str, options: Variant) -> None:
        sources = copied_firmware(tmp_path / "firmware")
        where, right, wrong = DEFECTS[name]
        path = sources / "boards" / "uno" / where
        text = path.read_text()
        assert text.count(right) == 1, f"{where} has changed: adapt the defect {name!r}"
        path.write_text(text.replace(right, wrong))
        command = ["make", "-s", "-C", str(sources), "uno", *options.variables(), f"BUILD={tmp_path / 'build'}"]
        subprocess.run(command, check=True)
        hex_file = tmp_path / "build" / "uno" / f"{options.name}.hex"
        monkeypatch.setattr(chip_build, "build_chip", lambda *_: ChipFirmware(hex_file, real.library))

    yield build


# ---------------------------------------------------------------------- the bridge's timer


def emulator(which: str, options: Variant) -> ChipHost | SecondHost:
    """An armed chip on that emulator, which has not driven yet."""
    if which == "simavr":
        return armed_chip(HELD, options=options)
    host = SecondHost(SecondChip(QUIET, options))
    host.setup(SETUP)
    assert host.arm_anew() == Code.NONE
    return host


def end(host: ChipHost | SecondHost) -> None:
    board = host.board
    if isinstance(board, SecondChip):
        board.__exit__()


def longest_pulse_s(host: ChipHost | SecondHost) -> float:
    """Since the last time that this was asked."""
    return host.board.longest_pulse_s()


def first_drive(which: str, options: Variant, units: int) -> tuple[float, float]:
    """Mean voltage and longest pulse of the first drive after a reset, V and s."""
    host = emulator(which, options)
    try:
        longest_pulse_s(host)
        host.drive(units)
        host.wait(0.002)
        pulse_s = longest_pulse_s(host)
        host.wait(0.002)
        return host.pin_V(), pulse_s
    finally:
        end(host)


@pytest.mark.parametrize("options", BRIDGES, ids=lambda o: o.bridge)
@pytest.mark.parametrize("which", ["simavr", "avr8js"])
def test_no_pulse_is_longer_than_its_share(which: str, options: Variant) -> None:
    """The first one after a reset, and any after a zero, a turn or a change, at any phase of the counter."""
    rng = random.Random(3)
    host = emulator(which, options)
    try:
        assert longest_pulse_s(host) == 0.0
        last = 0
        for units in DRIVES * 3:
            host.wait(rng.uniform(0.0, 100e-6))
            host.drive(units)
            host.wait(0.0006)
            assert longest_pulse_s(host) <= max(abs(units), abs(last)) * UNIT_S + 4 * CYCLE_S
            host.wait(0.001)
            assert longest_pulse_s(host) == pytest.approx(abs(units) * UNIT_S, abs=4 * CYCLE_S)
            assert host.pin_V() == pytest.approx(units * UNIT_V, abs=0.05 * UNIT_V)
            last = units
    finally:
        end(host)


@pytest.mark.parametrize("options", BRIDGES, ids=lambda o: o.bridge)
@pytest.mark.parametrize("which", ["simavr", *evidence("avr8js")])
def test_icr1_before_the_mode_is_no_drive_or_full_drive(
    which: str, options: Variant, build_with: Callable[[str, Variant], None]
) -> None:
    build_with("as it was", options)
    mean_V, _ = first_drive(which, options, 20)
    assert mean_V == (0.0 if options.bridge == "PWM_DIR" else 12.0)


@pytest.mark.parametrize("which", ["simavr", *evidence("avr8js")])
def test_the_first_pulse_of_in1_in2_was_full_supply_for_half_a_period(
    which: str, build_with: Callable[[str, Variant], None]
) -> None:
    options = BRIDGES[1]
    build_with("as it was, with the mode before ICR1", options)
    mean_V, pulse_s = first_drive(which, options, 20)
    assert mean_V == pytest.approx(20 * UNIT_V, abs=0.05 * UNIT_V)
    assert pulse_s >= 25e-6


def longest_after(units: int, before: int, options: Variant) -> float:
    """Longest pulse of a drive, s, after one and a zero of many durations."""
    host = emulator("simavr", options)
    longest_s = 0.0
    for k in range(40):
        host.drive(before)
        host.wait(0.001 + 1.3e-6 * k)
        host.drive(0)
        longest_pulse_s(host)
        host.drive(units)
        host.wait(0.001)
        longest_s = max(longest_s, longest_pulse_s(host))
    return longest_s


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("begun anywhere", BRIDGES[0]),
        ("the buffer alone", BRIDGES[1]),
        *evidence(
            ("the clock before the pin", BRIDGES[1]), ("begun anywhere", BRIDGES[1]), ("the buffer alone", BRIDGES[0])
        ),
    ],
)
def test_a_level_or_a_share_left_over_from_the_drive_before_is_a_long_pulse(
    name: str, options: Variant, build_with: Callable[[str, Variant], None]
) -> None:
    assert longest_after(1, 200, options) == pytest.approx(UNIT_S, abs=4 * CYCLE_S)
    build_with(name, options)
    assert longest_after(1, 200, options) > 10e-6


@pytest.mark.parametrize("options", [BRIDGES[0], *evidence((BRIDGES[1],))], ids=["PWM_DIR", "IN1_IN2"])
def test_a_buffer_that_normal_mode_does_not_reach_is_written_too(
    options: Variant, build_with: Callable[[str, Variant], None]
) -> None:
    """The data sheet leaves that open; the emulator takes it the worse way: no drive after the first period."""
    build_with("not the buffer", options)
    assert first_drive("simavr", options, 20)[0] == 0.0


# ---------------------------------------------------------------------- every register


def visit(host: ChipHost) -> str:
    """What uses every register: drives, turns, stops, and a watchdog that bites. The first rule broken."""
    board = host.board
    for units in (20, 60, -60, 0, 1):
        host.drive(units)
        host.wait(0.003)
    board.hang()
    host.wait(0.3)
    return board.broken_rule()


@pytest.mark.parametrize("options", [*BRIDGES, EVERYTHING], ids=lambda o: o.name)
def test_the_firmware_keeps_every_rule_that_the_emulator_knows(options: Variant) -> None:
    host = armed_chip(HELD, SETUP._replace(watchdog_ms=1000), options)
    assert visit(host) == ""
    assert host.truth().resets == 1
    assert host.hello().reset_words == "watchdog"
    host.setup()
    assert host.arm_anew() == Code.NONE
    host.drive(20)
    assert host.pin_V() == pytest.approx(20 * UNIT_V)
    assert host.board.broken_rule() == ""


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("interrupts on in a drive", "interrupts on, section 16.3"),
        ("baud rate of a port that is on", "20.5"),
        ("watchdog's flag left", "WDRF"),
        *evidence(
            ("ICR1 before the mode", "16.6"),
            ("as it was", "16.6"),
            ("TCNT1 in PWM", "16.7.3"),
            ("the low byte first", "16.3"),
            ("ICR1 while it counts", "16.9.5"),
            ("the LED and its neighbour", "14.1"),
            ("ADMUX in a conversion", "24.5"),
            ("a fast converter", "24.4"),
            ("error flags written", "20.11.2"),
            ("power-down", "10.11.1"),
            ("watchdog without its sequence", "11.9.2"),
        ),
    ],
)
def test_a_broken_rule_is_named(name: str, rule: str, build_with: Callable[[str, Variant], None]) -> None:
    build_with(name, BRIDGES[0])
    board = VirtualChip(HELD)
    host = ChipHost(board)
    host.send_raw(b"\0")
    host.wait(0.01)
    if not board.broken_rule():
        host.setup(SETUP._replace(watchdog_ms=1000))
        host.arm_anew()
        visit(host)
    assert rule in board.broken_rule()


def test_sleep_follows_sei() -> None:
    """No interrupt between the last look and sleep: it would be slept through."""
    sei, sleep = bytes.fromhex("7894"), bytes.fromhex("8895")
    code = b""
    for line in chip_build.build_chip().hex.read_text().split():
        record = bytes.fromhex(line[1:])
        code += record[4 : 4 + record[0]] if record[3] == 0 else b""
    assert code.count(sleep) == code.count(sei + sleep) == 1


# ---------------------------------------------------------------------- the table in the documents

PAGE = "registers-uno.md"
WRITES = re.compile(
    r"^\s+(?P<register>[A-Z][A-Z0-9]{2,}) [|&^]?= "
    r"|\b(?:set|clear)_bits\(&(?P<port>[A-Z]+),"
    r"|\b(?P<macro>(?:wdt|sleep)_[a-z]+)\(",
    re.MULTILINE,
)
HARMLESS = {"wdt_reset", "sleep_cpu"}  # instructions, no writes


def test_each_row_of_the_table_is_in_the_source_and_has_its_test() -> None:
    defects = DEFECTS.keys() - {"as it was, with the mode before ICR1"}
    check_rules(PAGE, BRIDGE.parent, r"[0-9.]+((, | to )[0-9.]+)*", defects)


def test_each_write_to_a_register_has_its_row() -> None:
    told = {where: "" for where, _ in itertools.chain(*(kept_by(row[2]) for row in rules(PAGE)))}
    for where, line in itertools.chain(*(kept_by(row[2]) for row in rules(PAGE))):
        told[where] += line + "\n"
    written = {
        (path.name, name)
        for path in BRIDGE.parent.glob("*.c")
        for found in WRITES.finditer(path.read_text())
        for name in found.groups()
        if name is not None and name not in HARMLESS
    }
    assert len(written) > 25
    for where, name in sorted(written):
        assert re.search(rf"\b{name}\b", told.get(where, "")), (
            f"{where} writes {name}: docs/evidence/registers-uno.md has no row for it"
        )
