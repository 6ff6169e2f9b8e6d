"""What the columns of somebody's own log are: which column is the time, the drive, the position, and in which unit."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rig.core.errors import CauseError
from rig.run_folder.recording.servo_law import ServoLaw

# For each quantity its units: what one of them is in s, V, rad and rad/s. None: it takes a further number of the log.
UNITS: Final[dict[str, dict[str, float | None]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "drive": {"V": 1.0, "mV": 1e-3, "pwm": None, "duty": None, "percent": None},
    "position": {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi, "counts": None},
    "velocity": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "turns/s": 2.0 * math.pi,
        "rpm": math.pi / 30.0,
        "counts/s": None,
    },
}
UNITS["goal"] = UNITS["position"]
# First words of the usual names of each column, in small letters: "Time (ms)", "pwm", "encoder_counts", "Winkel [deg]".
# fmt: off
USUAL_NAMES: Final = {
    "time": {
        "t", "time", "times", "timestamp", "millis", "micros", "ms", "us", "sec", "seconds", "zeit", "temps",
        "tiempo", "tempo", "stamp", "datetime", "elapsed", "时间", "時間",
    },
    "drive": {
        "u", "drive", "pwm", "duty", "volt", "volts", "voltage", "input", "command", "control", "motor", "spannung",
        "stellgröße", "tension", "tensión", "voltaje", "tensione", "commande", "电压", "電圧",
    },
    "position": {
        "y", "pos", "position", "angle", "theta", "phi", "count", "counts", "ticks", "enc", "encoder", "deg",
        "winkel", "lage", "posición", "posicion", "ángulo", "angulo", "posizione", "angolo", "角度", "位置",
    },
    "velocity": {
        "v", "vel", "velocity", "speed", "omega", "rpm", "w", "drehzahl", "geschwindigkeit", "vitesse", "velocidad",
        "velocità", "转速", "速度",
    },
    "goal": {"goal", "target", "setpoint", "reference", "ref", "action", "ziel", "sollwert", "consigne"},
}
USUAL_SUPPLY: Final = {"voltage", "volts", "volt", "vin", "supply", "input", "battery", "spannung"}
# fmt: on
# Words of a column's name, or of a row of units, that say its unit, in small letters.
_WORDS: Final[dict[str, dict[str, str]]] = {
    "time": {
        "ms": "ms msec millis milliseconds",
        "us": "us usec micros microseconds",
        "ns": "ns nsec nsecs nanoseconds",
        "s": "s sec secs second seconds sekunden secondes",
    },
    "drive": {"pwm": "pwm", "duty": "duty", "V": "volt volts", "mV": "mv", "percent": "percent prozent"},
    "position": {
        "rad": "rad radians",
        "deg": "deg degrees grad degrés",
        "turns": "turns rev revs umdrehungen tours",
        "counts": "count counts ticks",
    },
    "velocity": {
        "rpm": "rpm min"  # U/min, tr/min
    },
}
NAMES_UNIT: Final = {
    quantity: {word: unit for unit, words in units.items() for word in words.split()}
    for quantity, units in _WORDS.items()
}
NAMES_UNIT["goal"] = NAMES_UNIT["position"]
ALL_UNITS: Final = {
    *(unit.lower() for units in UNITS.values() for unit in units),
    *(word for words in NAMES_UNIT.values() for word in words if word not in ("millis", "micros", "min")),
    *["%", "°", "°/s", "a", "ma", "u/min", "tr/min", "1/min", "min-1", "rev/min", "rev/s", "u/s", "tr/s"],
}
"""What a field of a row of units may say, in small letters."""
_WORD: Final = re.compile(r"[^\W\d_]+?(?:(?<=[a-z][a-z])(?=[A-Z])|(?![^\W\d_]))")  # of "leftSpeed": left, Speed
_RATE: Final = re.compile(r"/\s*(s|sec|min)\b|(?<![^\W_])per(?![^\W_])", re.IGNORECASE)  # in a velocity's name
_PERIOD: Final = re.compile(r"\s*([0-9.eE+-]+)\s*(s|ms|us|ns)\s*")
_CURRENTS: Final = ("A", "mA")
CURRENT_CAUSE: Final = "a current is a torque: under it a motor has no K, and no tau of its own"
CURRENT_CURE: Final = "log the voltage at the motor, or the bridge's duty"
_CURRENT_WORDS: Final = {
    "amps", "ampere", "amperes", "strom", "motorstrom", "courant", "corriente", "corrente", "torque", "drehmoment",
}  # fmt: skip
MOST_ROWS_OFF: Final = 5
LARGEST: Final = 1e19  # number in a log, above nanoseconds since 1970
OWN_NAMES: Final = {"time": "t_s", "drive": "u_V", "position": "y_rad", "velocity": "v_rad_per_s", "goal": "yd_rad"}
"""The column of samples.csv that each quantity becomes; a log may have it under this name."""


def words_of(name: str) -> list[str]:
    """The words of a column's name, in small letters."""
    return [word.lower() for word in _WORD.findall(name)]


def sounds_like(name: str, quantity: str) -> bool:
    """Whether the first word of a column's name is a usual one for this quantity."""
    return any(word in USUAL_NAMES[quantity] for word in words_of(name)[:1])


def units_said(name: str, quantity: str) -> set[str]:
    """The units of this quantity that a column's name, or its field in a row of units, says."""
    said = {unit for word in words_of(name) if (unit := NAMES_UNIT[quantity].get(word))}
    if quantity == "velocity":
        return said | {unit for unit in UNITS[quantity] if unit in name}
    if _RATE.search(name):  # of a speed: "rad/s" is neither an angle nor a time
        return set()
    if quantity == "drive":
        said |= {"V" for k, word in enumerate(_WORD.findall(name)) if word == "V" or (word == "v" and k > 0)}
        said |= {"percent"} if "%" in name else set()
        return said - {"pwm", "duty"} if "percent" in said else said  # of these it is the unit
    return said | ({"deg"} if quantity != "time" and "°" in name else set())


def units_of_column(name: str, of_row: str, quantity: str) -> set[str]:
    """The units of this quantity that a column says, by the row of units if this says any, else by its name."""
    return ({of_row} & UNITS[quantity].keys()) or units_said(of_row, quantity) or units_said(name, quantity)


def usual_places(names: Sequence[str], quantity: str, unit: str) -> list[int]:
    """Places of the columns that may be this quantity by their names: one that is its own name or unit comes first."""
    free = [k for k, name in enumerate(names) if quantity != "drive" or not says_current(name)]
    exact = [k for k in free if names[k] in (OWN_NAMES[quantity], unit)]
    return exact or [k for k in free if sounds_like(names[k], quantity)]


def says_current(name: str, of_row: str = "") -> bool:
    """Whether a column is a current, or a torque, by its name or by its field in a row of units."""
    words = [word for word in _WORD.findall(name) if word.lower() not in ("a", "ma")]
    ampere = re.search(r"[(\[]\s*m?A\s*[)\]]|(?<![^\W_])mA(?![^\W_])|^[iI]_?A$", name)
    spoken = {word.lower() for word in words} & _CURRENT_WORDS or words[-1:] in (["current"], ["Current"])
    return of_row in _CURRENTS or (bool(ampere or spoken) and not units_said(name, "drive") and not of_row)


class LogFormatError(CauseError):
    """Columns or units of a log that cannot be."""


@dataclass(frozen=True)
class LogColumn:
    """One column of a log.

    unit    one of ``UNITS`` of its quantity
    column  its name, or its number from 1; None: the column with a usual name of that quantity
    """

    unit: str
    column: str | None = None

    @classmethod
    def parse(cls, quantity: str, text: str) -> LogColumn:
        """From ``UNIT`` or ``COLUMN:UNIT``. Raises LogFormatError."""
        column, colon, unit = text.rpartition(":")
        units = ", ".join(UNITS[quantity])
        unit = {one.lower(): one for one in UNITS[quantity]}.get(unit.lower(), unit)
        if unit not in UNITS[quantity]:
            if quantity == "drive" and (unit in _CURRENTS or (not colon and says_current(unit))):
                raise LogFormatError(f"--drive {text}: {CURRENT_CAUSE}", CURRENT_CURE)
            if column in UNITS[quantity] and unit.isdecimal():
                raise LogFormatError(
                    f"--{quantity} {text}: the column comes first, then its unit", f"type --{quantity} {unit}:{column}"
                )
            if quantity == "position" and unit in ("V", "mV"):
                raise LogFormatError(
                    f"--position {text}: {unit} alone says nothing of the angle",
                    f"of a potentiometer count its {unit}, and say how many one turn is: --position "
                    f"{column or 'COLUMN'}:counts --counts-per-turn {'6' if unit == 'V' else '6000'}",
                )
            example = next(iter(UNITS[quantity]))
            named = f"--{quantity} {(column if colon else unit) or 'COLUMN'}:{example}"
            raise LogFormatError(
                f"--{quantity} {text}: {unit!r} is no unit of {quantity}",
                f"give one of {units}; with a column before it if its name does not tell: {named}",
            )
        if colon and not column.strip():
            raise LogFormatError(
                f"--{quantity} {text} names no column", f"give its name or number: --{quantity} 1:{unit}"
            )
        return cls(unit, column.strip() or None)


def parse_period(text: str, option: str = "--period") -> float:
    """A time such as 2ms, 500us or 0.01s, in s, above 0. Raises LogFormatError."""
    found = _PERIOD.fullmatch(text)
    try:
        period_s = float(found[1]) * (UNITS["time"][found[2]] or math.nan) if found else math.nan
    except ValueError:
        period_s = math.nan
    if not 0.0 < period_s < LARGEST:
        raise LogFormatError(f"{option} {text} is no time above 0", f"give a number with its unit: {option} 2ms")
    return period_s


@dataclass(frozen=True)
class LogFormat:
    """The columns of a log, and the numbers that turn them into s, V and rad.

    time, drive      each a column; None: the log has t_s or u_V
    position         None: the log has y_rad, or a velocity alone
    velocity         instead of a position
    counts_per_turn  of the measured shaft, gear included, > 0; for counts
    full             the drive's number at full supply, > 0; for pwm
    supply_V         volts at the motor at full drive, > 0; for pwm, duty and percent
    reversed         whether a positive drive turns the shaft to falling positions: positions change their sign
    period_s         time from row to row, s, > 0, instead of a column of times
    run              name or number of the column that says which run a row is of; None: a time that begins again does
    drive_row        rows by which the drive stands too late, negative: too early; at most 5. -1: each row has the drive
                     that was set before its position was read, so all drives move up by a row
    direction        name or number of the column that says which way the drive acts, where the drive has no sign
    time_row         the same of the time. -1: each row has the time of the row before
    goal, servo      of a log that a servo's own position loop made, in place of a drive
    Raises LogFormatError if a number is missing, useless or not positive.
    """

    time: LogColumn | None = None
    drive: LogColumn | None = None
    position: LogColumn | None = None
    velocity: LogColumn | None = None
    counts_per_turn: float | None = None
    full: float | None = None
    supply_V: float | None = None
    reversed: bool = False
    period_s: float | None = None
    run: str | None = None
    direction: str | None = None
    drive_row: int = 0
    time_row: int = 0
    goal: LogColumn | None = None
    servo: ServoLaw | None = None

    def __post_init__(self) -> None:
        self._require_one_drive()
        if self.position is not None and self.velocity is not None:
            raise LogFormatError(
                "--position and --velocity are both given", "leave --velocity out: the position says more"
            )
        if self.time is not None and self.period_s is not None:
            raise LogFormatError("--time and --period are both given", "leave one of them out")
        for option, rows in (("--drive-row", self.drive_row), ("--time-row", self.time_row)):
            if abs(rows) > MOST_ROWS_OFF:
                raise LogFormatError(
                    f"{option} {rows} is more than {MOST_ROWS_OFF} rows", f"a log is off by one: {option} -1"
                )
        drive = "duty" if self.servo is not None else "V" if self.drive is None else self.drive.unit
        motion = next((one.unit for one in (self.position, self.velocity, self.goal) if one is not None), "rad")
        missing: dict[str, str] = {}  # whoever lacks two options is asked for both at once
        units: set[str] = set()
        for option, value, needed_by, unit, example in (
            ("--counts-per-turn", self.counts_per_turn, ("counts", "counts/s"), motion, "1440"),
            ("--full", self.full, ("pwm",), drive, "255"),
            ("--supply-V", self.supply_V, ("pwm", "duty", "percent"), drive, "12"),
        ):
            if value is None and unit in needed_by and not (option == "--supply-V" and self.servo is not None):
                missing[f"{option} {example}"] = _MEANING[option]
                units.add(unit)
            if value is not None and unit not in needed_by:
                raise LogFormatError(
                    f"{option} is for {' and '.join(needed_by)}, and this log has {unit}",
                    "leave it out, or correct the unit",
                )
            if value is not None and not 0.0 < value < LARGEST:
                raise LogFormatError(f"{option} {value:g} is not above 0", f"{_MEANING[option]}: {option} {example}")
        if missing:
            options = " and ".join(option.split()[0] for option in missing)
            raise LogFormatError(
                f"a log in {' and '.join(sorted(units))} needs {options}",
                f"give {'; '.join(words.removeprefix('give ') for words in missing.values())}: {' '.join(missing)}",
            )

    def _require_one_drive(self) -> None:
        """Raise LogFormatError where a log has a drive and a servo's goals, or options of the other kind."""
        if self.servo is None and self.goal is not None:
            raise LogFormatError("--goal is for the log of a servo's own loop", "add --servo MODEL and --gain P")
        if self.servo is None:
            return
        for option, given in (
            ("--drive", self.drive), ("--velocity", self.velocity), ("--reversed", self.reversed),
            ("--full", self.full), ("--direction", self.direction),
        ):  # fmt: skip
            if given:
                raise LogFormatError(
                    f"{option} and --servo are both given", "a servo's law gives the drive: leave one out"
                )
        if self.drive_row not in (0, -1) or self.time_row:
            raise LogFormatError("of a servo's log no row can be moved", "--drive-row -1: the goal was written first")

    def columns(self) -> dict[str, LogColumn]:
        """The column of each quantity that is read: time unless a period is given, drive or goal, and the motion."""
        motion = "position" if self.velocity is None else "velocity"
        timed = {"time": self.time} if self.period_s is None else {}
        drive = {"drive": self.drive} if self.servo is None else {"goal": self.goal}
        given = {**timed, **drive, motion: self.position or self.velocity}
        return {name: one or LogColumn(next(iter(UNITS[name])), OWN_NAMES[name]) for name, one in given.items()}

    def most(self, unit: str) -> float | None:
        """The largest number of a drive in this unit that a bridge can give; None for V and mV."""
        return {"pwm": self.full, "duty": 1.0, "percent": 100.0}.get(unit)

    def scale(self, quantity: str, unit: str) -> float:
        """What one unit is in s, V, rad or rad/s; positions and velocities with their sign."""
        size = UNITS[quantity][unit]
        if size is None:
            size = {
                "pwm": (self.supply_V or math.nan) / (self.full or math.nan),
                "duty": self.supply_V or math.nan,
                "percent": 0.01 * (self.supply_V or math.nan),
                "counts": 2.0 * math.pi / (self.counts_per_turn or math.nan),
                "counts/s": 2.0 * math.pi / (self.counts_per_turn or math.nan),
            }[unit]
        return -size if self.reversed and quantity in ("position", "velocity") else size


_MEANING: Final = {
    "--counts-per-turn": "give the counts of one turn of the shaft, gear and all edges included",
    "--full": "give the number that means full drive",
    "--supply-V": "give the volts at the motor at full drive: the supply less the bridge's drop",
}
