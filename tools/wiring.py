"""Draws the wiring of a bench with an Arduino Uno, docs/wiring.svg, and of each bridge, docs/bridges.svg.

The pins are those of the firmware's wiring.h.

python tools/wiring.py
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, NamedTuple
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parent.parent
HEADER = ROOT / "firmware/boards/uno/wiring.h"
PICTURE = ROOT / "docs/wiring.svg"
BRIDGES_PICTURE = ROOT / "docs/bridges.svg"

WIPER_PULL_DOWN_OHM = 100e3
BRIDGE_PULL_DOWN_OHM = 10e3
# from the motor supply, and to ground: 20 V give the converter its 5 V
SUPPLY_UPPER_OHM, SUPPLY_LOWER_OHM = 30e3, 10e3
# from the tachometer, to 5 V, and to ground: -10 V to 10 V become 0 V to 5 V
TACHOMETER_OHM, TACHOMETER_UP_OHM, TACHOMETER_DOWN_OHM = 20e3, 10e3, 20e3
LED_OHM = 1e3

Point = tuple[float, float]
Anchor = Literal["start", "middle", "end"]

STYLE = """
  svg { font-family: Helvetica, Arial, sans-serif; font-size: 14px; }
  .paper { fill: #ffffff; stroke: #b8bfc7; }
  .box { fill: #eef2f6; stroke: #24303c; stroke-width: 2; }
  .body { fill: #ffffff; stroke: #24303c; stroke-width: 1.6; }
  .wire { fill: none; stroke: #24303c; stroke-width: 1.6; }
  .motor { fill: none; stroke: #b3401e; stroke-width: 4; stroke-linejoin: round; }
  .optional { fill: none; stroke: #5d6b7a; stroke-width: 1.2; stroke-dasharray: 6 5; }
  .gap { fill: none; stroke: #ffffff; stroke-width: 3; }
  .wide { stroke-width: 6; }
  .wrong-box { fill: #ffffff; stroke: #b3401e; stroke-width: 2; stroke-dasharray: 8 5; }
  .dot { fill: #24303c; }
  text { fill: #24303c; }
  .name { font-weight: bold; }
  text.wrong { font-weight: bold; fill: #b3401e; }
  .small { font-size: 12px; }
  .dim { fill: #4d5a68; font-size: 12px; }
  @media (prefers-color-scheme: dark) {
    .paper { fill: #12171d; stroke: #3a4552; }
    .box { fill: #1d2630; stroke: #d5dde5; }
    .body { fill: #12171d; stroke: #d5dde5; }
    .wire { stroke: #d5dde5; }
    .motor { stroke: #f08a5d; }
    .wrong-box { fill: #12171d; stroke: #f08a5d; }
    .gap { stroke: #12171d; }
    .optional { stroke: #93a1b0; }
    .dot, text { fill: #d5dde5; }
    .dim { fill: #a3b0bd; }
    text.wrong { fill: #f08a5d; }
  }
"""


def pins(header: str) -> dict[str, str]:
    """From the #defines of wiring.h to the names that are printed on an Uno, e.g. PIN_LED to D13."""
    names = {"D": 0, "B": 8}  # number of the port's first pin
    found = {
        name: f"D{names[port] + int(bit)}"
        for name, port, bit in re.findall(r"#define (PIN_\w+) BIT\(P([BD])(\d)\)", header)
    }
    return found | {name: f"A{number}" for name, number in re.findall(r"#define (CHANNEL_\w+) (\d)u", header)}


def ohms(value: float) -> str:
    """A resistance as it is written in drawings."""
    return f"{value / 1e3:g} kΩ"


class Drawing:
    """A circuit diagram that grows; coordinates in pixels, y downwards."""

    def __init__(self, width: int, height: int, title: str = "Wiring of a bench with an Arduino Uno") -> None:
        self._size = width, height
        self._title = title
        self._parts: list[str] = []

    def svg(self) -> str:
        """The whole file."""
        width, height = self._size
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
                f"<title>{escape(self._title)}</title>",
                f"<style>{STYLE}</style>",
                f'<rect class="paper" x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" rx="8"/>',
                *self._parts,
                "</svg>\n",
            ]
        )

    def line(self, *points: Point, kind: str = "wire") -> None:
        """A wire from point to point."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        self._parts.append(f'<polyline class="{kind}" points="{path}"/>')

    def path(self, d: str, kind: str = "wire") -> None:
        """Any SVG path."""
        self._parts.append(f'<path class="{kind}" d="{d}"/>')

    def rectangle(self, x: float, y: float, width: float, height: float, kind: str = "box") -> None:
        """From its upper left corner."""
        self._parts.append(f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="3"/>')

    def circle(self, x: float, y: float, radius: float, kind: str = "body") -> None:
        """From its centre."""
        self._parts.append(f'<circle class="{kind}" cx="{x:g}" cy="{y:g}" r="{radius:g}"/>')

    def text(self, x: float, y: float, words: str, anchor: Anchor = "start", kind: str = "small") -> None:
        """One line, on its base line; several where `words` has line breaks."""
        for k, line in enumerate(words.split("\n")):
            self._parts.append(
                f'<text class="{kind}" x="{x:g}" y="{y + 16 * k:g}" text-anchor="{anchor}">{escape(line)}</text>'
            )

    def joint(self, x: float, y: float) -> None:
        """Wires that meet here are connected."""
        self.circle(x, y, 3.6, "dot")

    def across(self, x: float, y: float, value: str = "") -> None:
        """A resistor in a horizontal wire, about its centre."""
        self.rectangle(x - 22, y - 8, 44, 16, "body")
        self.text(x, y - 13, value, "middle")

    def down(self, x: float, y: float, value: str = "", *, left: bool = False) -> None:
        """A resistor in a vertical wire, about its centre."""
        self.rectangle(x - 8, y - 20, 16, 40, "body")
        self.text(x + (-14 if left else 14), y + 5, value, "end" if left else "start")

    def ground(self, x: float, y: float) -> None:
        """Ground, below the point."""
        for k, half in enumerate((13, 8, 3)):
            self.line((x - half, y + 5 * k), (x + half, y + 5 * k))

    def five_volts(self, x: float, y: float) -> None:
        """The Uno's 5 V, above the point."""
        self.line((x - 10, y), (x + 10, y))
        self.text(x, y - 6, "5V", "middle")

    def closed_contact(self, x: float, y: float, kind: str = "wire") -> None:
        """A contact that is closed until somebody presses it, in a horizontal wire, about its centre."""
        self.circle(x - 20, y, 3.6, "body")
        self.circle(x + 20, y, 3.6, "body")
        self.line((x - 17, y + 3), (x + 24, y + 7), kind=kind)

    def pin(self, x: float, y: float, name: str, side: Literal["left", "right"]) -> None:
        """The name of a box's pin, inside of its left or right edge."""
        self.text(x + (9 if side == "left" else -9), y + 5, name, "start" if side == "left" else "end", "name")


def draw(pin: dict[str, str]) -> str:
    """The picture, as SVG. ``pin``: as ``pins`` gives it."""
    d = Drawing(1240, 1130)
    _potentiometer(d, pin)
    _tachometer(d, pin)
    _supply_divider(d, pin)
    _contacts(d, pin)
    _bridge(d, pin)
    _motor_supply(d)
    _other_bridge(d, pin)
    _encoder(d, pin)
    _legend(d)
    return d.svg()


def _potentiometer(d: Drawing, pin: dict[str, str]) -> None:
    d.rectangle(470, 100, 180, 590)
    d.text(560, 132, "Arduino Uno", "middle", "name")
    d.text(560, 678, "USB: power and link", "middle")
    d.line((470, 170), (130, 170), (130, 330), (470, 330))
    d.rectangle(120, 205, 20, 90, "body")
    d.line((470, 250), (146, 250))
    d.path("M 141 250 l 10 -5 v 10 z", "dot")
    d.text(108, 236, "potentiometer\n1 kΩ, linear,\non the shaft", "end")
    d.line((370, 250), (370, 330))
    d.down(370, 290, ohms(WIPER_PULL_DOWN_OHM), left=True)
    d.joint(370, 250)
    d.joint(370, 330)
    d.text(164, 242, "wiper", kind="small")
    d.text(384, 286, "pull-down,\nat the Uno", kind="dim")
    d.pin(470, 170, "5V", "left")
    d.pin(470, 250, pin["CHANNEL_POSITION"], "left")
    d.pin(470, 330, "GND", "left")


def _tachometer(d: Drawing, pin: dict[str, str]) -> None:
    d.rectangle(20, 368, 436, 180, "optional")
    d.text(30, 387, "optional: --tachometer", kind="dim")
    d.line((470, 450), (90, 450), (90, 522))
    d.circle(90, 486, 19)
    d.text(90, 491, "G", "middle", "name")
    d.text(118, 490, "tachometer,\n-10 V to 10 V")
    d.ground(90, 522)
    d.across(170, 450, ohms(TACHOMETER_OHM))
    d.line((290, 450), (290, 400))
    d.five_volts(290, 400)
    d.down(290, 424, ohms(TACHOMETER_UP_OHM))
    d.line((370, 450), (370, 522))
    d.down(370, 486, ohms(TACHOMETER_DOWN_OHM))
    d.ground(370, 522)
    d.joint(290, 450)
    d.joint(370, 450)
    d.pin(470, 450, pin["CHANNEL_TACHOMETER"], "left")


def _supply_divider(d: Drawing, pin: dict[str, str]) -> None:
    d.rectangle(20, 566, 436, 130, "optional")
    d.text(30, 585, "optional: --supply", kind="dim")
    d.line((470, 620), (120, 620))
    d.circle(116, 620, 4)
    d.text(106, 625, "Vs, at the", "end")
    d.text(106, 641, "bridge", "end")
    d.across(200, 620, ohms(SUPPLY_UPPER_OHM))
    d.line((370, 620), (370, 672))
    d.down(370, 648, ohms(SUPPLY_LOWER_OHM))
    d.ground(370, 672)
    d.joint(370, 620)
    d.pin(470, 620, pin["CHANNEL_SUPPLY"], "left")


def _contacts(d: Drawing, pin: dict[str, str]) -> None:
    d.line((650, 420), (850, 420), (850, 650))
    d.across(710, 420, ohms(LED_OHM))
    d.path("M 766 409 v 22 l 20 -11 z", "dot")
    d.line((787, 409), (787, 431))
    d.text(868, 424, "LED beside the Uno's own: lit while armed,\nblinks while a fault is latched")
    d.line((650, 500), (850, 500))
    d.text(
        868,
        496,
        "e-stop, contact 2, normally closed; the pull-up is in\nthe chip. No such contact: wire the pin to ground",
    )
    d.rectangle(664, 542, 546, 116, "optional")
    d.text(1200, 559, "optional: --end-switches", "end", "dim")
    d.line((650, 580), (850, 580))
    d.text(868, 585, "end switch at falling counts, normally closed")
    d.line((650, 630), (850, 630))
    d.text(868, 635, "end switch at rising counts, normally closed")
    for y in (500, 580, 630):
        _open_gap(d, 740, y)
        d.closed_contact(740, y)
        d.joint(850, y)
    d.ground(850, 668)
    d.line((850, 650), (850, 668))
    d.pin(650, 420, pin["PIN_LED"], "right")
    d.pin(650, 500, pin["PIN_ESTOP"], "right")
    d.pin(650, 580, pin["PIN_END_LOW"], "right")
    d.pin(650, 630, pin["PIN_END_HIGH"], "right")


def _open_gap(d: Drawing, x: float, y: float) -> None:
    d.line((x - 20, y), (x + 20, y), kind="gap")


def _bridge(d: Drawing, pin: dict[str, str]) -> None:
    d.rectangle(840, 130, 130, 200)
    d.text(961, 252, "H-bridge", "end", "name")
    d.text(961, 269, "(PWM, DIR)", "end")
    d.line((650, 170), (840, 170))
    d.line((650, 220), (840, 220))
    d.line((650, 300), (840, 300))
    d.line((740, 220), (740, 300))
    d.down(740, 260, ohms(BRIDGE_PULL_DOWN_OHM))
    d.joint(740, 220)
    d.joint(740, 300)
    d.text(728, 258, "pull-down,\nat bridge", "end", "dim")
    for y, here, there in (
        (170, pin["PIN_DIRECTION"], "DIR"),
        (220, pin["PIN_OC1A"], "PWM"),
        (300, "GND", "GND"),
    ):
        d.pin(650, y, here, "right")
        d.pin(840, y, there, "left")
    d.text(745, 322, "no motor current here", "middle", "dim")


def _motor_supply(d: Drawing) -> None:
    d.line((970, 180), (1090, 180), (1090, 250), (970, 250), kind="motor")
    d.circle(1090, 215, 24)
    d.text(1090, 220, "M", "middle", "name")
    d.line((1190, 198), (1190, 50), (905, 50), (905, 130), kind="motor")
    d.line((1190, 208), (1190, 360), (905, 360), (905, 330), kind="motor")
    d.line((1170, 198), (1210, 198))
    d.line((1180, 208), (1200, 208), kind="motor")
    d.text(1160, 196, "+", "end", "name")
    d.text(1174, 296, "motor supply, 12 V\n(20 V at most\nwith --supply)", "end")
    d.rectangle(1110, 42, 44, 16, "body")
    d.text(1132, 32, "fuse", "middle")
    d.line((1020, 50), (980, 50), kind="gap wide")
    d.closed_contact(1000, 50, "motor")
    d.text(1000, 32, "e-stop, contact 1, normally closed", "middle")
    d.line((905, 100), (1010, 100), (1010, 112))
    d.line((996, 112), (1024, 112))
    d.line((996, 119), (1024, 119))
    d.line((1010, 119), (1010, 134))
    d.ground(1010, 134)
    d.joint(905, 100)
    d.text(1034, 120, "470 µF, at the bridge")
    d.text(916, 147, "Vs", kind="name")
    d.text(916, 322, "GND", kind="name")
    d.ground(940, 372)
    d.line((940, 360), (940, 372))
    d.joint(940, 360)
    d.text(962, 386, "here all grounds meet", kind="dim")


def _encoder(d: Drawing, pin: dict[str, str]) -> None:
    """Instead of the potentiometer; the pull-ups are in the chip."""
    d.text(470, 946, "An encoder instead of the potentiometer: --encoder", kind="name")
    d.rectangle(470, 960, 180, 150)
    d.text(560, 1032, "Arduino Uno", "middle", "name")
    d.rectangle(840, 960, 130, 150)
    d.text(961, 1032, "quadrature", "end", "name")
    d.text(961, 1050, "encoder", "end", "name")
    for y, there, here in (
        (980, "5V", "5V"),
        (1012, "A", pin["PIN_ENCODER_A"]),
        (1044, "B", pin["PIN_ENCODER_B"]),
        (1092, "GND", "GND"),
    ):
        d.line((650, y), (840, y))
        d.pin(650, y, here, "right")
        d.pin(840, y, there, "left")
    d.text(
        990,
        1006,
        "On the motor, or behind its gear.\nThe pull-ups are in the chip.\n"
        "Long wires: away from the motor's.\nA0 stays free.",
    )


def _other_bridge(d: Drawing, pin: dict[str, str]) -> None:
    d.text(470, 736, "A bridge with IN1 and IN2 instead: --bridge in1-in2", kind="name")
    d.rectangle(470, 750, 180, 160)
    d.text(560, 862, "Arduino Uno", "middle", "name")
    d.rectangle(840, 750, 130, 160)
    d.text(961, 862, "H-bridge", "end", "name")
    d.text(961, 879, "(IN1, IN2)", "end")
    d.line((650, 770), (840, 770))
    d.line((650, 805), (840, 805))
    d.line((650, 840), (840, 840))
    d.line((650, 895), (840, 895))
    d.path("M 700 805 V 834 a 6 6 0 0 1 0 12 V 895")
    d.line((770, 840), (770, 895))
    for x, y in ((700, 805), (770, 840)):
        d.rectangle(x - 8, 852, 16, 34, "body")
        d.text(x + 14, 874, ohms(BRIDGE_PULL_DOWN_OHM))
        d.joint(x, y)
        d.joint(x, 895)
    for y, here, there in (
        (770, "5V", "EN"),
        (805, pin["PIN_OC1A"], "IN1"),
        (840, pin["PIN_OC1B"], "IN2"),
        (895, "GND", "GND"),
    ):
        d.pin(650, y, here, "right")
        d.pin(840, y, there, "left")
    d.text(
        990,
        800,
        "Motor, supply and e-stop as above.\nBoth inputs high: 0 V.\nEnable (EN, both of an L298's) tied high.",
        kind="small",
    )


def _legend(d: Drawing) -> None:
    d.line((30, 770), (80, 770), kind="motor")
    d.text(95, 775, "motor current, thick wire, twisted pair to the motor")
    d.line((30, 800), (80, 800))
    d.text(95, 805, "signal")
    d.line((30, 830), (80, 830), kind="optional")
    d.text(95, 835, "optional, with the option of rig flash that reads it")
    d.ground(55, 854)
    d.text(95, 865, "ground: one net, star point at the bridge")


class Module(NamedTuple):
    """A bridge as it is sold, and where its pins go.

    wires     what each wire joins: a pin of the Uno by its name in wiring.h, or 5V or GND; the module's pins
    inputs    names in wiring.h of the two pins whose wires get a pull-down
    is_wrong  whether it is drawn as a warning
    """

    title: str
    words: str
    wires: tuple[tuple[str, str], ...]
    inputs: tuple[str, str] | None = ("PIN_OC1A", "PIN_OC1B")
    is_wrong: bool = False


MODULES = (
    Module(
        "L298N as most pages wire it: NOT like this",
        "PWM at ENA: while it is\nlow the motor runs free,\nand 0 V does not brake.",
        (("PWM", "ENA, no jumper"), ("a pin", "IN1"), ("another", "IN2"), ("GND", "GND")),
        None,
        is_wrong=True,
    ),
    Module(
        "L298N: --bridge in1-in2",
        "Jumper back on ENA.\nTwo wires to move:\nIN1 to D9, IN2 to D10.",
        (("PIN_OC1A", "IN1"), ("PIN_OC1B", "IN2"), ("GND", "GND")),
    ),
    Module(
        "TB6612FNG: --bridge in1-in2",
        "Motor supply at VM,\n13.5 V at most;\nmotor at AO1, AO2.",
        (("5V", "VCC, STBY, PWMA"), ("PIN_OC1A", "AIN1"), ("PIN_OC1B", "AIN2"), ("GND", "GND")),
    ),
    Module(
        "DRV8871: --bridge in1-in2",
        "Motor supply at VM,\n6.5 V at least; the board\nlimits the current.",
        (("PIN_OC1A", "IN1"), ("PIN_OC1B", "IN2"), ("GND", "GND")),
    ),
    Module(
        "BTS7960, IBT-2: --bridge in1-in2",
        "Motor supply at B+, B-.\nR_IS, L_IS stay open.",
        (("5V", "VCC, R_EN, L_EN"), ("PIN_OC1A", "RPWM"), ("PIN_OC1B", "LPWM"), ("GND", "GND")),
    ),
    Module(
        "PWM and DIR (Cytron MD10C, ...): --bridge pwm-dir",
        "It must brake while PWM\nis low. The Arduino Motor\nShield (L298P) does not.",
        (("PIN_DIRECTION", "DIR"), ("PIN_OC1A", "PWM"), ("GND", "GND")),
        ("PIN_OC1A", "PIN_OC1A"),
    ),
)


def draw_bridges(pin: dict[str, str]) -> str:
    """The picture of the bridges, as SVG. ``pin``: as ``pins`` gives it."""
    width, height = 620, 250
    d = Drawing(2 * width, height * ((len(MODULES) + 1) // 2) + 8, "Wiring of bridges as they are sold")
    for k, module in enumerate(MODULES):
        _module(d, module, pin, width * (k % 2), height * (k // 2))
    return d.svg()


def _module(d: Drawing, module: Module, pin: dict[str, str], x: float, y: float) -> None:
    d.text(x + 30, y + 36, module.title, kind="wrong" if module.is_wrong else "name")
    d.rectangle(x + 30, y + 52, 80, 170)
    d.text(x + 70, y + 242, "Arduino Uno", "middle", "dim")
    d.rectangle(x + 270, y + 52, 160, 170, "wrong-box" if module.is_wrong else "box")
    d.text(x + 440, y + 80, module.words)
    levels = {name: y + 75 + 120 * k / (len(module.wires) - 1) for k, (name, _) in enumerate(module.wires)}
    for name, there in module.wires:
        d.line((x + 110, levels[name]), (x + 270, levels[name]))
        d.pin(x + 110, levels[name], pin.get(name, name), "right")
        d.pin(x + 270, levels[name], there, "left")
    ground = levels["GND"]
    for k, name in enumerate(dict.fromkeys(module.inputs or ())):
        at = x + 140 + 66 * k
        crossed = [other for wire, other in levels.items() if levels[name] < other < ground and wire != name]
        hops = "".join(f" V {other - 6:g} a 6 6 0 0 1 0 12" for other in sorted(crossed))
        d.path(f"M {at:g} {levels[name]:g}{hops} V {ground:g}")
        d.rectangle(at - 8, ground - 29, 16, 22, "body")
        d.text(at + 12, ground - 13, ohms(BRIDGE_PULL_DOWN_OHM))
        d.joint(at, levels[name])
        d.joint(at, ground)


def main() -> None:
    """Write the pictures."""
    pin = pins(HEADER.read_text(encoding="utf-8"))
    BRIDGES_PICTURE.write_text(draw_bridges(pin), encoding="utf-8")
    PICTURE.write_text(draw(pin), encoding="utf-8")


if __name__ == "__main__":
    main()
