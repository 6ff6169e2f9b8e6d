"""Reads a log of Rhoban/bam: a JSON object with what hung on the servo, its gain, and an entry for each sample.

An entry has `timestamp` (s), `position` and `goal_position` (rad), `torque_enable`, and mostly `input_volts`. The goal
was written before the position was read. While the torque is off nothing is known of the bridge: the longest stretch
with it is read.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import JsonValue

from rig.core import strict_json
from rig.core.strict_json import JsonError
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_file import servo_recording
from rig.run_folder.recording.log_format import LogFormat
from rig.run_folder.recording.recording import FIT_ROWS, Recording
from rig.run_folder.recording.servo_law import SCALES, ServoLaw
from rig.run_folder.recording.text_file import content_of, text_of
from rig.run_folder.results import JsonObject

_MOST_BYTES: Final = 200_000_000
_MOST_VALUES: Final = 10_000_000  # nine of an entry: an hour and a half at 200 Hz
# of BAM's motors whose position mode rig knows: the protocol, the ramp as shipped, V/s, and whether I and D are 0 as
# shipped (ROBOTIS e-Manual; of an STS3215 no manual says): BAM writes P alone
_MOTORS: Final = {"xl330": ("dynamixel", 140 * 1.977, True), "sts3215": ("feetech", math.inf, False)}
_NUMBERS: Final = ("timestamp", "position", "goal_position")


def read_bam_log(path: Path, log: LogFormat | None = None) -> Recording | None:
    """Such a log as a recording; None for a file of another kind.

    log  what the user states of the servo; its P and its scale go before the log's. Raises RecordingError.
    """
    if path.suffix.lower() != ".json" or not path.is_file():
        return None
    text = text_of(path, content_of(path, _MOST_BYTES))
    try:
        data = strict_json.parse(text, _MOST_VALUES)
    except JsonError as error:
        if '"entries"' in text and '"kp"' in text:
            cure = "leave the broken entry out, or record again" if error.line else "cut it into several logs"
            raise RecordingError(path, f"is broken JSON ({error})", cure, error.line) from error
        return None
    entries = data.get("entries") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(entries, list) or "kp" not in data:
        return None
    law, P = _law(path, data, None if log is None else log.servo)
    rows = _rows(path, entries)
    t_s, y_rad, goal_rad = (np.array([float(one[name]) for one in rows]) for name in _NUMBERS)  # type: ignore[arg-type]
    late = np.flatnonzero(np.diff(t_s) <= 0.0)
    if late.size:
        raise RecordingError(path, f"its time does not rise after entry {int(late[0])}", "record it again")
    notes = [_load_in_words(data), f"{len(rows)} of {len(entries)} entries are read: the longest with the torque on"]
    stated = None if log is None else log.supply_V
    supply_V = _supply_V(path, data, rows) if stated is None else stated
    return servo_recording(path, (t_s, y_rad, goal_rad), range(1, len(rows) + 1), (law, P), supply_V, notes)


def _law(path: Path, data: JsonObject, stated: ServoLaw | None) -> tuple[ServoLaw, float]:
    name = str(data.get("motor"))
    motor = _MOTORS.get(name)
    if stated is None and motor is None:
        raise RecordingError(
            path, f"is of a motor whose P rig does not know: {name}", "say which servo it is: --servo MODEL"
        )
    if stated is not None and stated.model and motor is not None and not stated.model.startswith(name):
        raise RecordingError(path, f"says that its motor is {name}, not {stated.model}", "leave --servo out")
    if stated is None and motor is not None:
        protocol, slew_V_s, is_P_alone = motor
        stated = ServoLaw(None, SCALES[protocol], slew_V_s, is_P_alone=is_P_alone)
    assert stated is not None
    return replace(stated, goal_first=True), _number(path, data, "kp") if stated.P is None else stated.P


def _rows(path: Path, entries: Sequence[JsonValue]) -> list[JsonObject]:
    """The longest stretch of entries with the torque on."""
    rows: list[JsonObject] = []
    for number, one in enumerate(entries):
        if not isinstance(one, dict) or not all(_is_number(one.get(name)) for name in _NUMBERS):
            raise RecordingError(path, f"entry {number} lacks one of {', '.join(_NUMBERS)}", "record it again")
        rows.append(one)
        if one.get("torque_enable", True) not in (True, False):
            raise RecordingError(path, f"the torque_enable of entry {number} is neither true nor false", "correct it")
    stretches = [list(group) for on, group in groupby(rows, lambda one: bool(one.get("torque_enable", True))) if on]
    longest = max(stretches, key=len, default=[])
    if len(longest) < FIT_ROWS:
        raise RecordingError(path, f"has {len(longest)} entries in a row with the torque on", "record more")
    return longest


def _supply_V(path: Path, data: JsonObject, rows: list[JsonObject]) -> float:
    """The median of what the servo told, else what the log states."""
    told = [float(volts) for one in rows if _is_number(volts := one.get("input_volts")) and volts]  # type: ignore[arg-type]
    supply_V = float(np.median(told)) if told else _number(path, data, "vin")
    if not supply_V > 0.0:
        raise RecordingError(path, f"says that its input_volts are {supply_V:g}", "give the volts at it: --supply-V 5")
    return supply_V


def _number(path: Path, data: JsonObject, name: str) -> float:
    value = data.get(name)
    if not _is_number(value) or not float(value) > 0.0:  # type: ignore[arg-type]
        raise RecordingError(path, f"its {name} is no number above 0", "correct it, or state it as an option")
    return float(value)  # type: ignore[arg-type]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _load_in_words(data: JsonObject) -> str:
    load = [f"{name} {data[name]}" for name in ("mass", "arm_mass", "arm-mass", "length") if _is_number(data.get(name))]
    return (
        f"a log of BAM's, motor {data.get('motor')}; the load is part of the motor: {', '.join(load) or 'none stated'}"
    )
