"""The first config of a bench, from a few answers: the board's ready config with its comments, and the answers put in.

What can be answered stands in tables: a board, a sensor or a bridge more is one line more.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import PurePath
from typing import Final

from rig.config import ready
from rig.config.bridges import BRIDGES, COASTS, RUNS_FREE, BridgeModule
from rig.config.edit import Value, with_values
from rig.config.problems import Path
from rig.config.schema import GainSearchSection
from rig.core.errors import CauseError

_EXAMPLE_HARD_RAD: Final = 1.6  # limits.hard_rad of the examples: their limits, speed and amplitudes go with it
_EXAMPLE_SUPPLY_V: Final = 12.0  # drive.supply_V of the examples, whose search begins with less than such a friction
_MARGIN_RAD: Final = 0.2  # from the hard limits to the mechanical stops
_POTENTIOMETER_RAD: Final = math.radians(270.0)  # electrical travel of a usual one
_LARGEST_TRAVEL_DEG: Final = 125.0  # to each side: what that potentiometer shows without its ends
_LEAST_TRAVEL_DEG: Final = 40.0  # less is too small for the steps of 10 bits
_LARGEST_ENCODER_DEG: Final = 3600.0
_LARGEST_SIZE: Final = 1.25  # of the example's swings, however wide the travel
_MOST_COUNTS: Final = 10_000_000  # for a turn of an encoder's own shaft
_LEAST_COUNTS: Final = 400.0  # of an encoder, for a turn of the measured shaft
_MOTION_RAD: Final = 0.025  # breakaway.motion_rad of the examples
_MOTION_COUNTS: Final = 4.0  # of an encoder, that it is at least
_LEAST_TURNS: Final = 2.0
_SLOW_SHARE: Final = 0.8  # of what the bridge can give: drive.max_V of a motor that is slow even with that
_LEAST_MOST_V: Final = 3.0  # drive.max_V, and relay.search.h_max_V where it is left out
LEAST_CYCLE_COUNTS: Final = 34.0  # of the sensor: the second test's are 0.7 of them less 15 %, and need 20


class AnswerError(CauseError):
    """An answer that cannot be."""


@dataclass(frozen=True)
class Board:
    """A board that rig has firmware for.

    words       what it is, for people
    example     the ready config that the new one is made of
    counts_max  largest reading of its converter
    edges_s     edges of an encoder that it counts, at most, a second
    channels    pins of an encoder, for people
    flash       option of `rig flash` that names it, with a space before it; "": none is needed
    """

    words: str
    example: str
    counts_max: int
    edges_s: float
    channels: str
    flash: str = ""


BOARDS: Final = {
    "uno": Board("Arduino Uno or Nano", "uno", 1023, 39_000.0, "D2 and D3"),
    "pico": Board("Raspberry Pi Pico", "pico", 4095, 1_900_000.0, "GP2 and GP3, at most 3.3 V", flash=" --board pico"),
}
SENSORS: Final = {"potentiometer": "potentiometer on the shaft", "encoder": "quadrature encoder, counts in the board"}
LIMITS: Final = {
    "stops": "the shaft meets a stop on each side, or must not turn farther",
    "turns": "it turns without end, but no farther than some turns either way",
    "none": "it turns without end: a person must be able to reach the e-stop",
}
TESTS: Final = {
    "full": "limit cycles at two pairs of gains, recorded and identified by each method: two minutes, or four if slow",
    "quick": "tests that rig designs, until tau, K and f_c are known: some seconds; no limit cycle is recorded",
}


@dataclass(frozen=True)
class Answers:
    """What somebody says of a bench.

    board, sensor, bridge, limits  keys of ``BOARDS``, ``SENSORS``, ``BRIDGES`` and ``LIMITS``
    port                   of the board
    supply_V               motor supply, V
    travel_deg             from the centre of travel to the mechanical stop on each side, degrees; for limits "stops"
    no_load_rpm            speed of the measured shaft without load at that supply, revolutions a minute
    counts_per_turn, gear  of an encoder: counts for a turn of its shaft, and its turns for one of the measured shaft
    turns                  either way, for limits "turns"
    usb_serial             of the board that is plugged in at the port; "": none is, or it has no such number
    tests                  key of ``TESTS``
    Raises AnswerError.
    """

    board: str
    sensor: str
    bridge: str
    port: str
    supply_V: float
    travel_deg: float
    no_load_rpm: float
    limits: str = "stops"
    counts_per_turn: int = 64
    gear: float = 1.0
    turns: float = 10.0
    usb_serial: str = ""
    tests: str = "full"

    def __post_init__(self) -> None:
        require_braking(self.bridge)
        for answer, table in (
            (self.board, BOARDS),
            (self.sensor, SENSORS),
            (self.bridge, BRIDGES),
            (self.limits, LIMITS),
            (self.tests, TESTS),
        ):
            if answer not in table:
                raise AnswerError(f"{answer!r} is not among {', '.join(table)}", "give one of these")
        if not (math.isfinite(self.no_load_rpm) and self.no_load_rpm > 0.0):
            raise AnswerError(
                f"a speed of {self.no_load_rpm:g} revolutions a minute is none",
                "see the motor's data sheet, behind the gear",
            )
        module = BRIDGES[self.bridge]
        if not 2.0 * module.drop_V < self.supply_V <= module.largest_V:
            raise AnswerError(
                f"a motor supply of {self.supply_V:g} V is nothing for {module.words}: {2.0 * module.drop_V:g} to "
                f"{module.largest_V:g} V",
                "another supply or another bridge",
            )
        if self.limits == "stops":
            self._check_travel()
        if self.sensor == "encoder":
            self._check_encoder()
        elif self.limits != "stops":
            raise AnswerError(
                "a potentiometer has ends: its shaft does not turn without end", "--limits stops, or --sensor encoder"
            )
        if self.limits == "turns" and not _LEAST_TURNS <= self.turns <= 100_000.0:
            raise AnswerError(f"{self.turns:g} turns either way are not {_LEAST_TURNS:g} to 100000", "give more turns")

    @property
    def counts(self) -> float:
        """Of the encoder, for a turn of the measured shaft."""
        return self.counts_per_turn * self.gear

    def _check_travel(self) -> None:
        is_encoder = self.sensor == "encoder"
        largest_deg = _LARGEST_ENCODER_DEG if is_encoder else _LARGEST_TRAVEL_DEG
        if not _LEAST_TRAVEL_DEG <= self.travel_deg <= largest_deg:
            why = "farther: --limits turns" if is_encoder else "a potentiometer of 270 degrees shows no more"
            raise AnswerError(
                f"{self.travel_deg:g} degrees to each side are not {_LEAST_TRAVEL_DEG:g} to {largest_deg:g}",
                f"less is too little to stop and to measure in; {why}",
            )

    def _check_encoder(self) -> None:
        if not 4 <= self.counts_per_turn <= _MOST_COUNTS:
            raise AnswerError(
                f"{self.counts_per_turn} counts a turn are no encoder",
                "four times the lines (PPR) of its data sheet, 4 or more",
            )
        if not (math.isfinite(self.gear) and self.gear > 0.0):
            raise AnswerError(f"a gear of {self.gear:g} is none", "turns of the encoder for one of the measured shaft")
        if self.counts < _LEAST_COUNTS:
            raise AnswerError(
                f"{self.counts:g} counts for a turn of the measured shaft are too few: {_LEAST_COUNTS:g} at least",
                "an encoder with more lines, or one on the motor's side of the gear (--gear)",
            )
        board = BOARDS[self.board]
        edges_s = self.counts * self.no_load_rpm / 60.0
        if edges_s > board.edges_s:
            raise AnswerError(
                f"at {self.no_load_rpm:g} rpm the encoder makes {edges_s:.0f} edges a second: the {board.words} counts "
                f"{board.edges_s:.0f}",
                "an encoder with fewer lines, or a slower motor" + (", or --board pico" if self.board == "uno" else ""),
            )


def require_braking(bridge: str) -> None:
    """Raise AnswerError for a bridge that lets the motor run free while PWM is low."""
    if bridge in RUNS_FREE:
        raise AnswerError(*COASTS)


def possible(board: str, sensor: str, bridge: str, limits: str, asked: str) -> Answers:
    """Answers of which any one that is ``asked`` is possible, unless none could be: the others leave it all room."""
    counts, gear, rpm = _MOST_COUNTS, 100.0, 1e-6
    if asked == "no_load_rpm":
        counts, gear = round(_LEAST_COUNTS), 1.0
    supply_V = BRIDGES[bridge].largest_V
    return Answers(board, sensor, bridge, "", supply_V, _LEAST_TRAVEL_DEG, rpm, limits, counts, gear)


def text(answers: Answers, file: str) -> str:
    """The config for this ``file``: the board's commented example with these answers in it."""
    module, board = BRIDGES[answers.bridge], BOARDS[answers.board]
    has_stops = answers.limits == "stops"
    hard_rad = round(math.radians(answers.travel_deg) - _MARGIN_RAD, 2) if has_stops else _EXAMPLE_HARD_RAD
    size = min(hard_rad / _EXAMPLE_HARD_RAD, _LARGEST_SIZE)
    soft_rad = round(0.56 * hard_rad, 2)
    calibrated_rad = round(hard_rad + 0.5 * _MARGIN_RAD, 2)
    middle = (board.counts_max + 1) // 2
    counts = round(min(calibrated_rad / _POTENTIOMETER_RAD * board.counts_max, 0.48 * board.counts_max))
    count_rad = calibrated_rad / counts if answers.sensor == "potentiometer" else 2.0 * math.pi / answers.counts
    seen_rad = math.ceil(100.0 * LEAST_CYCLE_COUNTS * count_rad) / 100.0
    full_V = answers.supply_V
    top_rad_s = math.ceil(answers.no_load_rpm * math.pi / 30.0 * 10.0) / 10.0
    max_rad_s = math.floor(45.0 * size) / 10.0
    slow_V = min(full_V * max_rad_s / top_rad_s, _SLOW_SHARE * (full_V - module.drop_V))  # no faster with it
    most_V = round(max(min(max(_LEAST_MOST_V, full_V / 4.0), 0.5 * (full_V - module.drop_V)), slow_V), 1)
    values: dict[Path, Value] = {
        ("name",): _name_of(file),
        ("daq", "port"): answers.port,
        ("sensor", "calibration"): [{"counts": middle + way * counts, "rad": way * calibrated_rad} for way in (-1, 1)],
        ("drive", "bridge"): module.inputs,
        ("drive", "supply_V"): full_V,
        ("drive", "bridge_drop_V"): module.drop_V,
        ("drive", "max_V"): most_V,
        ("breakaway", "max_V"): round(max(1.5, full_V / 8.0), 2),  # friction grows with the supply that a motor is for
        ("motor", "no_load_speed_rad_s"): top_rad_s,
        ("limits", "soft_rad"): [-soft_rad, soft_rad],
        ("limits", "hard_rad"): [-hard_rad, hard_rad],
        ("limits", "max_speed_rad_s"): max_rad_s,
        ("relay", "target"): {"amplitude_rad": round(max(0.45 * size, seen_rad), 2), "period_s": 1.6},
        ("tracking", "trajectory"): [
            {"amplitude_rad": round(share * size, 2), "omega_rad_s": omega} for share, omega in ((0.4, 1.5), (0.2, 3.1))
        ],
    }
    search: dict[str, float] = {}
    if full_V < _EXAMPLE_SUPPLY_V:  # an h1 above friction makes no cycle
        for key in ("h1_start_V", "h2_start_V", "h2_step_V"):
            search[key] = round(getattr(GainSearchSection(), key) * full_V / _EXAMPLE_SUPPLY_V, 3)
    if most_V > _LEAST_MOST_V:
        search["h_max_V"] = most_V
    if search:
        values["relay", "search"] = search
    if answers.usb_serial:  # of this bench's board: another one at the port is refused
        values["daq", "usb_serial"] = answers.usb_serial
    new = ready.text(board.example)
    if answers.tests == "quick":
        new = _until_known(new)
        del values["relay", "target"]
    new = with_values(new, values)
    if answers.sensor == "encoder":
        new = _with_encoder(new, answers)
    if not has_stops:
        new = _without_stops(new, answers)
    return _with_introduction(new, answers, module).replace(f"config/{board.example}.yaml", file)


def _name_of(file: str) -> str:
    """The name of runs by this config: that of the file, where it can be one."""
    stem = PurePath(file).stem
    return stem if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", stem) else "bench"


def _with_encoder(config: str, answers: Answers) -> str:
    """With an encoder in place of the potentiometer, in the section and among the wiring of the first comment."""
    start, end = config.index("sensor:"), config.index("\ndrive:")
    zero = "" if answers.limits != "stops" else "; zero is what `rig home` sets, once after each reset"
    section = f"""\
sensor:
  encoder:                  # at {BOARDS[answers.board].channels}: docs/encoder.md{zero}
    # Of the encoder's own shaft, all four edges of a period counted: four times the lines (PPR) of its data sheet. Turn
    # the shaft once by hand: the column y_counts in the samples.csv of `rig jog {_file_of(answers)} --u-V 0` shows it.
    counts_per_turn: {answers.counts_per_turn}
    gear: {answers.gear:<8g}          # turns of the encoder for one turn of the measured shaft
    sign: 1                 # -1 if the counts fall where the position should rise
"""
    motion_rad = max(_MOTION_RAD, _MOTION_COUNTS * 2.0 * math.pi / answers.counts)
    whole = config[:start] + section + config[end:]
    new = with_values(whole, {("breakaway", "motion_rad"): round(motion_rad, 3)})
    new = re.sub(r"(?m)^#   \* (?:pull-down on the wiper|the potentiometer's dead zone).*\n(?:#     .*\n)*", "", new)
    return re.sub(r"(?m); potentiometer between .*$", "; the encoder's ground, too.", new)


def _file_of(answers: Answers) -> str:
    """As the example names itself, which ``text`` replaces."""
    return f"config/{BOARDS[answers.board].example}.yaml"


def _without_stops(config: str, answers: Answers) -> str:
    """With `travel: none`, and a bound in turns if there is one, in place of soft and hard limits."""
    start, end = config.index("  # Hard limits at least"), config.index("  # Generous guesses")
    lines = ["  travel: none              # zero is where each command finds the shaft"]
    if answers.limits == "turns":
        lines.append(f"  turns: {answers.turns:<8g}           # either way from there: beyond, 0 V and a latched fault")
    else:
        lines[0] += "; the firmware arms once the e-stop was pressed and released"
    return config[:start] + "\n".join(lines) + "\n" + config[end:]


def _until_known(config: str) -> str:
    """With tests that end when the motor is known, in place of a wanted limit cycle."""
    start, end = config.index("relay:\n"), config.index("\ntracking:")
    until = "  until: {interval_percent: 0.4}    # the tests end when tau, K and f_c are known so well: docs/until.md\n"
    return f"{config[:start]}relay:\n{until}{config[end:]}"


def _with_introduction(config: str, answers: Answers, module: BridgeModule) -> str:
    """With the first comment, which speaks of the example, in words of this bench."""
    board = BOARDS[answers.board]
    start, end = config.index("# A real bench"), config.index("#\n# Wiring that no software")
    introduction = f"""\
# A real bench: {board.words}, {module.words}, DC gear motor,
# {SENSORS[answers.sensor]}. Written by `rig init`; what it asked is put in.
# Every other number is an example of a plausible bench: measure yours, as the comments say, then run `rig check` on
# this file. docs/real-bench.md has the wiring diagram and the first steps, one by one. The firmware for this bench:
# `rig flash config/{board.example}.yaml{board.flash}`.
"""
    head = config[:start]
    without_schema = "\n".join(line for line in head.splitlines() if "yaml-language-server" not in line)
    return without_schema + introduction + config[end:]
