"""Drawings of wires: which to check, and which two to swap; as text for a terminal, as SVG for a page."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Final

from rig.config.schema import Experiment


@dataclass(frozen=True)
class Wiring:
    """Two parts and the wires between them.

    title        what to do
    left, right  the parts
    wires        (terminal of the left part, terminal of the right part), from top to bottom
    swap         the first of two neighbouring wires that change places; None: check them all
    """

    title: str
    left: str
    right: str
    wires: tuple[tuple[str, str], ...]
    swap: int | None = None


@dataclass(frozen=True)
class _Pins:
    """Names of a board's pins, as printed beside them."""

    words: str
    high: str
    position: str
    ground: str
    encoder: tuple[str, str]
    bridge: tuple[str, str]  # of PWM or IN1, and of IN2
    direction: str


_BOARDS: Final = {
    "uno": _Pins("Arduino Uno", "5V", "A0", "GND", ("D2", "D3"), ("D9", "D10"), "D8"),
    "pico": _Pins("Pico", "ADC_VREF (35)", "GP26 (31)", "AGND (33)", ("GP2", "GP3"), ("GP16", "GP17"), "GP17"),
}
_OTHER = _Pins(
    "device", "supply of the sensor", "analogue input", "ground", ("channel A", "channel B"), ("PWM", "2"), "direction"
)
_OUTPUTS: Final = {"in1-in2": ("OUT1", "OUT2"), "pwm-dir": ("MA", "MB")}


def sensor(board: str) -> tuple[Wiring, ...]:
    """The wires of a potentiometer."""
    pins = _pins(board)
    wires = ((pins.high, "one end"), (pins.position, "wiper (middle)"), (pins.ground, "other end"))
    return (Wiring("check the sensor's wires, and that it turns with the shaft", pins.words, "potentiometer", wires),)


def encoder(board: str) -> tuple[Wiring, ...]:
    """The wires of an encoder."""
    pins = _pins(board)
    wires = ((pins.encoder[0], "A"), (pins.encoder[1], "B"), (pins.high, "supply"), (pins.ground, "ground"))
    return (Wiring("check the encoder's wires, and that it turns with the shaft", pins.words, "encoder", wires),)


def swapped_encoder(board: str) -> tuple[Wiring, ...]:
    """The channels of an encoder, swapped."""
    pins = _pins(board)
    wires = ((pins.encoder[0], "A"), (pins.encoder[1], "B"))
    return (Wiring("swap these two wires at one end", pins.words, "encoder", wires, swap=0),)


def swapped_motor(e: Experiment) -> tuple[Wiring, ...]:
    """The motor's two wires, swapped."""
    out = _OUTPUTS.get(e.drive.bridge or "", ("output 1", "output 2"))
    wires = ((out[0], "terminal 1"), (out[1], "terminal 2"))
    return (Wiring("swap these two wires at one end, with the motor's supply off", "bridge", "motor", wires, swap=0),)


def drive(e: Experiment, board: str) -> tuple[Wiring, ...]:
    """The way of the drive: from the board to the bridge, from supply and bridge to the motor."""
    pins = _pins(board)
    if e.drive.bridge == "pwm-dir":
        inputs = ((pins.bridge[0], "PWM"), (pins.direction, "DIR"), (pins.ground, "ground"))
    else:
        inputs = ((pins.bridge[0], "IN1"), (pins.bridge[1], "IN2"), (pins.ground, "ground"))
    out = _OUTPUTS.get(e.drive.bridge or "", ("output 1", "output 2"))
    return (
        Wiring("1. is the supply on, the e-stop released, the fuse whole?", "motor supply", "bridge",
               (("plus (fuse, e-stop)", "motor supply in"), ("minus", "ground"))),
        Wiring("2. do these wires sit?", pins.words, "bridge", inputs),
        Wiring("3. and these?", "bridge", "motor", ((out[0], "terminal 1"), (out[1], "terminal 2"))),
    )  # fmt: skip


def _pins(board: str) -> _Pins:
    return _BOARDS.get(board, _OTHER)


def text(w: Wiring) -> str:
    """The drawing in plain characters, no line longer than 79; two wires that change places cross."""
    size = max(len(left) for left, _ in w.wires)
    size = max(size, len(w.left))
    lines = [w.title, "", f"  {w.left:>{size}}               {w.right}"]
    for number, (left, right) in enumerate(w.wires):
        if number == w.swap:
            lines += [
                f"  {left:>{size}} o----.   .----o {right}",
                " " * (size + 2) + "       \\ /",
                " " * (size + 2) + "        X",
            ]
            lines += [" " * (size + 2) + "       / \\"]
        elif w.swap is not None and number == w.swap + 1:
            lines.append(f"  {left:>{size}} o----'   '----o {right}")
        else:
            lines.append(f"  {left:>{size}} o-------------o {right}")
    return "\n".join(lines)


# px; as narrow as the longest names allow, so that they can be read on a telephone, too
_ROW, _TOP, _BOX, _GAP = 42, 40, 168, 64
_LETTERS = 16  # that fit into a box, whatever the font


def svg(w: Wiring) -> str:
    """The drawing as SVG; what to do is its name, for the page to write above it.

    It takes the colour of the text around it; what to look at is in ``--accent``, or red.
    """
    width, height = 2 * _BOX + _GAP, _TOP + _ROW * len(w.wires) + 12
    inner, outer = _BOX, _BOX + _GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'font-family="system-ui, sans-serif" font-size="16" fill="currentColor">',
        f"<title>{escape(w.title)}</title>",
    ]
    for x, name, middle in ((1, w.left, _BOX / 2), (outer, w.right, outer + _BOX / 2)):
        parts += [
            f'<rect x="{x}" y="8" width="{_BOX - 2}" height="{height - 14}" rx="8" fill="none" stroke="currentColor"/>',
            f'<text x="{middle:g}" y="31" text-anchor="middle" font-weight="600">{escape(name)}</text>',
        ]
    y = [_TOP + _ROW * (row + 0.5) for row in range(len(w.wires))]
    for row in range(len(w.wires)):
        end = row
        if w.swap is not None and row in (w.swap, w.swap + 1):
            end = 2 * w.swap + 1 - row
            parts.append(
                f'<path d="M{inner} {y[row]:g}H{outer}" fill="none" stroke="currentColor" stroke-opacity="0.35" '
                'stroke-dasharray="4 5"/>'
            )
        parts.append(
            f'<path d="M{inner} {y[row]:g}L{outer} {y[end]:g}" fill="none" stroke="var(--accent, #c33)" '
            'stroke-width="3"/>'
        )
    for row, (left, right) in enumerate(w.wires):
        parts += [
            f'<circle cx="{inner}" cy="{y[row]:g}" r="5"/><circle cx="{outer}" cy="{y[row]:g}" r="5"/>',
            f'<text x="{inner - 14}" y="{y[row] + 5:g}" text-anchor="end"{_fitted(left)}>{escape(left)}</text>',
            f'<text x="{outer + 14}" y="{y[row] + 5:g}"{_fitted(right)}>{escape(right)}</text>',
        ]
    return "".join([*parts, "</svg>"])


def _fitted(name: str) -> str:
    """Attributes of a name that would leave its box in a wide font."""
    return f' textLength="{_BOX - 24}" lengthAdjust="spacingAndGlyphs"' if len(name) > _LETTERS else ""
