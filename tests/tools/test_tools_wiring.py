"""The wiring page against the firmware: picture, pin table and the numbers of its dividers."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

import wiring
from rig.backends.serial.frames import SUPPLY_UNIT_V
from rig.running.preflight import check

UNO = wiring.ROOT / "firmware/boards/uno"
PAGE = (wiring.ROOT / "docs/real-bench.md").read_text(encoding="utf-8")
PINS = wiring.pins(wiring.HEADER.read_text(encoding="utf-8"))


def table() -> dict[str, tuple[str, str]]:
    """Of the page: the firmware's name to (pin, words)."""
    rows = re.findall(r"^\| ([AD]\d+) \| (.+?) \| `(\w+)` \|$", PAGE, re.MULTILINE)
    return {name: (pin, words) for pin, words, name in rows}


def test_the_page_has_the_firmwares_pins_all_of_them_and_no_other() -> None:
    assert {name: pin for name, (pin, _) in table().items()} == PINS
    assert len(set(PINS.values())) == len(PINS) == 12


def test_wiring_h_says_in_words_what_it_defines() -> None:
    comment = wiring.HEADER.read_text(encoding="utf-8").split("*/")[0]
    numbers = {f"D{k}": f"PD{k}" if k < 8 else f"PB{k - 8}" for k in range(14)} | {f"A{k}": f"PC{k}" for k in range(6)}
    for pin in PINS.values():
        assert re.search(rf"\b{pin}\s+{numbers[pin]}\b", comment), pin


def test_the_pictures_are_those_of_the_source() -> None:
    assert wiring.PICTURE.read_text(encoding="utf-8") == wiring.draw(PINS)
    assert wiring.BRIDGES_PICTURE.read_text(encoding="utf-8") == wiring.draw_bridges(PINS)


@pytest.mark.parametrize("module", [one for one in wiring.MODULES if "in1-in2" in one.title], ids=lambda m: m.title[:7])
def test_the_table_of_bridges_is_what_the_picture_shows(module: wiring.Module) -> None:
    name = module.title.split(":")[0].split(",")[0]
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| {name}") and PINS["PIN_OC1A"] in line)
    for here, there in module.wires:
        if here != "GND":
            assert (there if here == "5V" else f"{there} {PINS[here]}") in row


@pytest.mark.parametrize(("style", "option"), [("PWM_DIR", "pwm-dir"), ("IN1_IN2", "in1-in2")])
def test_the_page_has_the_pins_of_each_bridge(style: str, option: str) -> None:
    source = (UNO / "bridge.c").read_text(encoding="utf-8")
    of_style = re.search(rf"RIG_BRIDGE == BRIDGE_{style}\n[^#]*#define PINS (.*)", source)
    assert of_style is not None
    driven = {PINS[name] for name in re.findall(r"PIN_\w+", of_style[1])}
    assert driven == {pin for pin, words in table().values() if f"`--bridge {option}`" in words}


def test_contacts_are_read_as_the_page_has_them_wired() -> None:
    source = (UNO / "inputs.c").read_text(encoding="utf-8")
    for name in ("PIN_ESTOP", "PIN_END_LOW", "PIN_END_HIGH"):
        assert "closed to ground" in table()[name][1]
        # pulled up, so that an open contact reads 1; and 1 is what stops
        assert re.search(rf"\((PIND|pins) & {name}\) != 0u", source)


def test_the_picture_is_drawn_from_the_firmwares_pins() -> None:
    picture = wiring.PICTURE.read_text(encoding="utf-8")
    assert picture == wiring.draw(PINS), "run python tools/wiring.py"
    words = [element.text for element in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")]
    for name, pin in PINS.items():
        if name.startswith("PIN_ENCODER"):
            continue  # the picture shows a bench with a potentiometer
        assert words.count(pin) == (2 if name == "PIN_OC1A" else 1), pin
    assert wiring.draw(PINS | {"PIN_ESTOP": "D7"}) != picture


def test_the_supply_divider_is_the_one_that_the_firmware_reckons_with() -> None:
    full_V = 5.0 * (wiring.SUPPLY_UPPER_OHM + wiring.SUPPLY_LOWER_OHM) / wiring.SUPPLY_LOWER_OHM
    assert full_V == pytest.approx(255 * SUPPLY_UNIT_V)


def test_the_tachometers_divider_keeps_the_converters_range_and_rests_at_its_middle() -> None:
    from_tachometer, from_5V, to_ground = (
        1.0 / r for r in (wiring.TACHOMETER_OHM, wiring.TACHOMETER_UP_OHM, wiring.TACHOMETER_DOWN_OHM)
    )
    total = from_tachometer + from_5V + to_ground
    at_pin_V = [(v * from_tachometer + 5.0 * from_5V) / total for v in (-10.0, 0.0, 10.0)]
    assert at_pin_V == pytest.approx([0.0, 2.5, 5.0])
    assert 1.0 / total <= 10e3  # that the converter's data sheet asks for
    a_count_mV = 1e3 * 20.0 / 1024
    assert f"{a_count_mV:.1f} mV" in " ".join(PAGE.split())


def test_the_page_says_how_far_the_pull_down_bends_the_reading() -> None:
    experiment, _ = check(wiring.ROOT / "config/uno.yaml")
    points = experiment.sensor.points
    lsb_rad = (points[-1][1] - points[0][1]) / (points[-1][0] - points[0][0])

    def bend_counts(potentiometer_ohm: float, angles: int) -> float:
        turned = np.linspace(points[0][0], points[-1][0], 4001) / 1023
        # Thevenin: the wiper's source is x (1 - x) of the potentiometer
        read = 1023 * turned / (1.0 + turned * (1.0 - turned) * potentiometer_ohm / wiring.WIPER_PULL_DOWN_OHM)
        at = np.linspace(turned[0], turned[-1], angles)
        return float(np.max(np.abs(read - np.interp(turned, at, np.interp(at, turned, read)))))

    said = re.search(
        r"by ([\d.]+) counts at 1 kΩ, ([\d.]+) at 5 kΩ, ([\d.]+) at 10 kΩ \((\d+) mrad "
        r".*? leaves ([\d.]+) and ([\d.]+)",
        " ".join(PAGE.split()),
    )
    assert said is not None
    for text, counts in zip(
        said.groups(),
        [
            bend_counts(1e3, 2),
            bend_counts(5e3, 2),
            bend_counts(10e3, 2),
            1e3 * lsb_rad * bend_counts(10e3, 2),
            bend_counts(5e3, 5),
            bend_counts(10e3, 5),
        ],
        strict=True,
    ):
        assert float(text) == pytest.approx(counts, rel=0.06)


def test_the_page_has_the_units_of_full_duty() -> None:
    full = re.search(r"#define BRIDGE_FULL (\d+)", (UNO / "bridge.h").read_text(encoding="utf-8"))
    assert full is not None
    assert f"in steps of 1/{full[1]} of full duty" in " ".join(PAGE.split())
