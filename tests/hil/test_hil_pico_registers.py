"""The Pico's registers against the RP2040 data sheet: the emulator names a breach of a rule, or it shows at the pins.

A defect is put into a copy of the sources, which is built; the tables: docs/evidence/registers-pico.md.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from evidence import evidence
from firmware_copy import copied_firmware
from pico_host import HELD, SETUP, PicoHost, pico
from register_table import check_rules, kept_by, rules, table

from emulated_chips import build as chip_build
from emulated_chips.build import PicoFirmware
from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import Block, Code, FrameReader, Kind, RelaySetup

pytestmark = pytest.mark.long

PAGE = "registers-pico.md"
BOARD = firmware_build.source_folder() / "boards" / "pico"
PLAIN, IN1_IN2 = Variant(), Variant(bridge="IN1_IN2")
EVERYTHING = Variant("IN1_IN2", 1_000_000, tachometer=True, supply=True, end_switches=True)


class Defect(NamedTuple):
    """Text of a file of boards/pico, and what stands there instead."""

    where: str
    right: str
    wrong: str
    options: Variant = PLAIN


DEFECTS = {
    "a peripheral left in reset": Defect("system.c", "RESETS_PADS_BANK0 | RESETS_PWM |", "RESETS_PADS_BANK0 |"),
    "a port set up while it is on": Defect(
        "uart.c",
        "    REG(UART0_LCR_H) = UART_LCR_H_8_BITS; /* after the divisor, which it brings into force */\n"
        "    REG(UART0_CR) = UART_CR_UARTEN | UART_CR_TXE | UART_CR_RXE;\n",
        "    REG(UART0_CR) = UART_CR_UARTEN | UART_CR_TXE | UART_CR_RXE;\n    REG(UART0_LCR_H) = UART_LCR_H_8_BITS;\n",
    ),
    "no first byte": Defect("uart.c", "    cpu_barrier();\n    send_next();\n", "    cpu_barrier();\n"),
    "a byte on top of another": Defect(
        "uart.c", "} else if ((REG(UART0_FR) & UART_FR_TXFF) == 0u) {", "} else if (out != to_send.in) {"
    ),
    "the tick before the others": Defect("clock.c", "    REG(NVIC_IPR0) = PRIORITY_LOWEST;", "    REG(NVIC_IPR0) = 0;"),
    "an alarm in the past": Defect("clock.c", "ahead_us < AHEAD_US || ahead_us > BELOW_0", "false"),
    "the alarm's flag left": Defect("clock.c", "    REG(TIMER_INTR) = ALARM_0;\n", ""),
    "a mark that is not there": Defect("system.c", "    REG(WATCHDOG_SCRATCH0) = OURS;\n", ""),
    "phase-correct": Defect("bridge.c", "REG(PWM_CH0_CSR) = PWM_EN;", "REG(PWM_CH0_CSR) = PWM_EN | 2u;"),
    "one input after the other": Defect(
        "bridge.c",
        "    REG(SIO_GPIO_OUT_SET) = HIGH_AT_REST;",
        "    REG(SIO_GPIO_OUT_SET) = BIT(PIN_PWM_A);\n    REG(SIO_GPIO_OUT_SET) = HIGH_AT_REST;",
        IN1_IN2,
    ),
    "a conversion on top of another": Defect(
        "adc.c",
        "    for (uint32_t i = 0; i < PATIENCE && (status & ADC_READY) == 0u; i++) {\n"
        "        status = REG(ADC_CS);\n    }\n"
        "    if ((status & ADC_READY) == 0u || ",
        "    if (",
        Variant(tachometer=True),
    ),
}


@pytest.fixture
def build_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Variant]]:
    """Builds the firmware with a defect, by name, and gives its options; from then on every chip runs it."""

    def build(name: str) -> Variant:
        defect = DEFECTS[name]
        real = chip_build.build_pico_chip(defect.options)
        sources = copied_firmware(tmp_path / "firmware")
        path = sources / "boards" / "pico" / defect.where
        text = path.read_text()
        assert text.count(defect.right) == 1, f"{defect.where} has changed: adapt the defect {name!r}"
        path.write_text(text.replace(defect.right, defect.wrong))
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
        command = ["make", "-s", "-C", str(sources), "pico", *defect.options.variables(), f"BUILD={tmp_path / 'build'}"]
        subprocess.run(command, check=True, env=environment)
        uf2 = tmp_path / "build" / "pico" / real.uf2.name
        monkeypatch.setattr(chip_build, "build_pico_chip", lambda *_: PicoFirmware(uf2, *real[1:]))
        return defect.options

    yield build


def visit(host: PicoHost) -> str:
    """What uses every register: drives, turns, stops, and a watchdog that bites. The first rule broken."""
    host.acknowledge(Code.RESET)
    host.setup(SETUP._replace(watchdog_ms=1000))
    assert host.arm() == Code.NONE
    for units in (300, 900, -900, 0, 15):
        host.drive(units)
        host.wait(0.003)
    host.board.hang()
    host.wait(0.2)
    assert host.hello().reset_words == "watchdog"
    return host.board.broken_rule()


@pytest.mark.parametrize("options", [PLAIN, *evidence((EVERYTHING,))], ids=lambda o: o.name_for("pico"))
def test_the_firmware_keeps_every_rule_that_the_emulator_knows(options: Variant) -> None:
    with pico(HELD, options) as host:
        assert visit(host) == ""


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("phase-correct", "a PWM mode"),
        *evidence(
            ("a peripheral left in reset", "in reset, section 2.14"),
            ("a port set up while it is on", "before it is set up, section 4.2"),
            ("a conversion on top of another", "while a conversion runs, section 4.9"),
        ),
    ],
)
def test_a_broken_rule_is_named(name: str, rule: str, build_with: Callable[[str], Variant]) -> None:
    with pico(HELD, build_with(name)) as host:
        host.wait(0.01)
        assert rule in host.board.broken_rule()


@pytest.mark.evidence
def test_a_byte_written_where_there_is_no_room_is_named(build_with: Callable[[str], Variant]) -> None:
    with pico(HELD, build_with("a byte on top of another")) as host:
        for _ in range(20):
            host.send(0x01)
        host.wait(0.05)
        assert "TXFF" in host.board.broken_rule()


@pytest.mark.evidence
def test_without_a_first_byte_the_port_never_asks_for_one(build_with: Callable[[str], Variant]) -> None:
    with pico(HELD, build_with("no first byte")) as host, pytest.raises(AssertionError, match="no reply"):
        host.hello()


def test_a_tick_that_goes_before_the_others_keeps_the_e_stop_waiting(build_with: Callable[[str], Variant]) -> None:
    """Off in 3 us at any phase as it is."""
    with pico(HELD, build_with("the tick before the others")) as host:
        host.acknowledge(Code.RESET)
        host.setup(SETUP)
        assert host.arm() == Code.NONE
        slowest_s = 0.0
        host.send(Kind.RELAY, RelaySetup((-900, 300, -300, 900), 2048 * 16, 12_000_000, 1, 10).pack())
        host.wait(0.03)
        told = [Block.unpack(p.body) for p in FrameReader().feed(host.board.read(0.0)) if p.kind == Kind.BLOCK]
        tick_s = 1e-6 * (told[-1].t_first_us % 1000)  # of each millisecond: its rows' samples, first thing in the tick
        for k in range(20):
            host.drive(900)
            now_s = host.board.now_s()
            host.board.sleep_until(1e-3 * int(1e3 * now_s + 1) + tick_s + 0.4e-6 * (k - 5))
            host.board.contact("e_stop", is_open=True)
            opened_s = host.board.now_s()
            host.wait(0.0005)
            slowest_s = max(slowest_s, host.truth().pin_changed_s - opened_s)
            host.board.contact("e_stop", is_open=False)
            host.wait(0.002)
            assert host.arm_anew() == Code.NONE
        assert slowest_s > 3e-6


@pytest.mark.parametrize("name", ["an alarm in the past", *evidence("the alarm's flag left")])
def test_a_clock_that_stops_or_runs_wild_is_reset_by_the_watchdog(
    name: str, build_with: Callable[[str], Variant]
) -> None:
    with pico(HELD, build_with(name)) as host:
        host.board.stall("tick", 2.5e-3)
        host.wait(0.13)  # the watchdog's 120 ms
        assert host.truth().resets > 0


@pytest.mark.evidence
def test_a_reset_by_the_watchdog_that_is_not_marked_is_not_told(build_with: Callable[[str], Variant]) -> None:
    with pico(HELD, build_with("a mark that is not there")) as host:
        host.board.hang()
        host.wait(0.2)
        assert host.truth().resets == 1 and host.hello().reset_words == "power-on"


@pytest.mark.evidence
def test_inputs_that_become_high_one_after_the_other_are_a_pulse(build_with: Callable[[str], Variant]) -> None:
    with pico(HELD, build_with("one input after the other")) as host:
        assert 0.0 < host.board.longest_pulse_s() < 1e-6


def test_a_program_without_its_checksum_is_not_started(tmp_path: Path) -> None:
    parameters = pico_parameters(HELD)
    uf2 = bytearray(Path(str(parameters["uf2"])).read_bytes())
    uf2[32] ^= 1  # the first byte of the program
    damaged = tmp_path / "damaged.uf2"
    damaged.write_bytes(uf2)
    with pytest.raises(EmulationError, match="checksum"):
        VirtualPico(parameters | {"uf2": str(damaged)})
    damaged.write_bytes(b"\0" * 512)
    with pytest.raises(EmulationError, match="no UF2 file"):
        VirtualPico(parameters | {"uf2": str(damaged)})


# ---------------------------------------------------------------------- the tables in the documents

WRITES = re.compile(r"\b(?:REG|CLEAR_BITS|SET_BITS)\(([A-Za-z_0-9]+(?:\(\w+\))?(?: \+ [A-Z_]+)?)(?:\) =|,)")


def test_each_row_of_the_table_is_in_the_source_and_has_its_test() -> None:
    check_rules(PAGE, BOARD, r"([0-9.]+|ARM DDI|erratum RP2040-E).*", DEFECTS.keys())


def test_each_write_to_a_register_has_its_row() -> None:
    told = "\n".join(line for row in rules(PAGE) for _, line in kept_by(row[2]))
    written = {found[1] for path in BOARD.glob("*.[ch]") for found in WRITES.finditer(path.read_text())}
    written -= {"address", "reverse"}
    assert len(written) > 25
    for register in sorted(written):
        name = register.split(" + ")[-1].split("(")[0]
        assert name in told, f"{register}: no row"


def test_each_address_is_the_data_sheets() -> None:
    """The header has the address that the table has; rp2040js, which is not ours, knows most of them by itself."""
    header = (BOARD / "rp2040.h").read_text()
    defined = {
        name: (address.upper(), step or "")
        for name, address, step in re.findall(
            r"#define (\w+)(?:\(pin\))? \(?0x([0-9A-F]{8})u(?: \+ (\d)u \* \(pin\)\))?", header
        )
    }
    told = table(PAGE, "### Addresses")
    assert len(told) >= 50
    for name, address, _ in told:
        number, _, step = address.partition(" + ")
        assert defined.pop(name) == (number[2:].upper(), step.removesuffix(" x pin")), name
    assert set(defined) == {"PSM_ALL_BUT_OSCILLATORS", "XOSC_ENABLE_1_15_MHZ"}  # values
